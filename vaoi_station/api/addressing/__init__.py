"""How callers address the station: the host names that it accepts, and the path of a proxy."""
