"""Assign every frame to its pulse by time, settle every (camera, row) of a run, and prove this. Pure logic."""
