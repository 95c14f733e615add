"""Cameras: one interface, one module per backend; backends do not know one another."""
