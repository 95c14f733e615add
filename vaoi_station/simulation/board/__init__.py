"""Generate a board: its parts, copper and artwork."""
