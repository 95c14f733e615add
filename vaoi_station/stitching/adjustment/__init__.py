"""Adjust a run: estimate row motion, C, surface and component heights in one robust least-squares problem."""
