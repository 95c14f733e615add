"""Hold frames in shared memory: the ring, its file and its layout."""
