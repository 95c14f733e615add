"""Score a rig run against the truth of the twin."""
