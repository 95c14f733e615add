"""Who sends a request, and how much of the station's resources each caller may use at a time."""
