"""Runs: each follows one board from the light barrier to its matrices and pictures.

Only one thread, the coordinator's, changes the state of runs and station, as the two tables in `states.tables` allow.
The REST service calls `control.coordinator`.
"""
