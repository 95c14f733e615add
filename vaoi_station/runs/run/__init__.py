"""Follow one board: its order, its progress, its memory in the ring, its views for callers."""
