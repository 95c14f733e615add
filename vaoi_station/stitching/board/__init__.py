"""Locate the board: detect its fiducials, assign them to the CAD data, check orientation and outline."""
