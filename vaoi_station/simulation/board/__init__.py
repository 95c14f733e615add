"""Generate a board: its parts, its copper and its artwork."""
