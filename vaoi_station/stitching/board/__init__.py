"""Locate the board: detect its fiducials, assign them to CAD, check orientation and outline."""
