"""The checks, one subject per module; a check changes nothing."""
