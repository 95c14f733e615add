"""The commands that work on recordings."""
