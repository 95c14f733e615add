"""Control the station: one thread decides, the coordinator; every other thread sends it requests or events."""
