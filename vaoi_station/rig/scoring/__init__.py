"""Score a rig run against the twin's truth, and print the report."""
