"""Render what a camera sees: rays, light, optics, sensor."""
