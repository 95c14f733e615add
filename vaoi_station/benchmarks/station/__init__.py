"""Benchmarks of a whole station: boards in real time, and time and memory over the length of a board."""
