"""Light programs."""
