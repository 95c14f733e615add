"""IPC-HERMES-9852 1.6: what the neighbours in the line say of their boards, and what the station answers."""
