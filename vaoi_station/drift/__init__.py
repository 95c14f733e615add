"""Whether the cameras still look where they were calibrated: told from the boards that pass, run by run."""
