"""Benchmarks of `vaoi bench`: stitching speed here, a whole station in real time in `station`, errors in `accuracy`."""
