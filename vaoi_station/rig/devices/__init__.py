"""Emulate devices: the controller's firmware on its chip, and GigE Vision cameras on loopback addresses."""
