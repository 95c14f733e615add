"""Emulate devices: the firmware on its chip, GigE Vision cameras on loopback addresses."""
