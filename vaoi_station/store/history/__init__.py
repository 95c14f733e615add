"""What is kept of finished runs: which of them, the checks of the calibration, decisions of persons, and the search."""
