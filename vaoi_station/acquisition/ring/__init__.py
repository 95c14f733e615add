"""Hold frames in shared memory: the ring, its file and its layout (docs/internals/ring.md)."""
