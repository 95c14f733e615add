"""The controller's serial protocol (`hw/protocol.md`) without any I/O: bytes in, bytes out, time as an argument."""
