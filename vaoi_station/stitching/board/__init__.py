"""Location of the board: detection of fiducials, assignment to the CAD data, check of orientation and outline."""
