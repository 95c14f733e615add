"""Pair every pulse with one frame per camera, by time, and prove the result."""
