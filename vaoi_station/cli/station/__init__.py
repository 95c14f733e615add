"""The commands that run a station or its devices."""
