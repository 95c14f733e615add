"""The parts of one run: its order, its progress, its memory in the ring, and its documents for callers."""
