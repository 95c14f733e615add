"""Generate a simulated board: place its parts, route its copper, and paint both as textures."""
