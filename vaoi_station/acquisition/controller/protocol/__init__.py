"""The serial protocol of the trigger controller without any port: bytes to messages and back (hw/protocol.md)."""
