"""The listening socket: which connections are accepted, and how long callers may take to send and to read."""
