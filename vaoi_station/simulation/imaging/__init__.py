"""Render what a camera sees: geometry, light, optics, sensor."""
