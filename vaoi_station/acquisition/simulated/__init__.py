"""Stand in for line, cameras and controller: the digital twin, or recordings."""
