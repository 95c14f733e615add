"""The callers of requests, and the share of the station's resources that each caller may use at a time."""
