"""Control the station: one thread decides, every other thread asks it."""
