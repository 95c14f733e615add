"""Benchmarks of `vaoi bench`: speed of stitching; in `station` a whole station; in `accuracy` errors."""
