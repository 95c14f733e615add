"""Check one subject per module; a check changes nothing."""
