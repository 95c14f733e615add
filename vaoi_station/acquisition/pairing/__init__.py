"""Assign every frame to its pulse by time, settle every (camera, row) of a run, and prove that this is right."""
