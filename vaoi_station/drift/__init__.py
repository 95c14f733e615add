"""Detect moved cameras and dim lights from the runs of boards since the calibration, and propose corrected N_i."""
