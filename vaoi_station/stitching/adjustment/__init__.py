"""Adjustment of a run: the motion of all rows, C, the surface and heights in one robust least-squares problem."""
