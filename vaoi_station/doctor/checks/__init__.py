"""The checks of `vaoi doctor`, one subject per module. No check changes anything."""
