"""Render the frame of a camera: geometry, light, optics and sensor."""
