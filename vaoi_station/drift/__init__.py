"""Detect cameras that have moved since their calibration, from the runs of boards, and propose corrected N_i."""
