"""Commands that run a station or its devices."""
