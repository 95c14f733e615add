"""Benchmarks of accuracy: measured and predicted errors of component positions, links and marks."""
