"""Benchmarks behind `vaoi bench`: speed in memory here, a station in real time in `station`, errors in `accuracy`."""
