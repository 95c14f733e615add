"""The listening socket: which connections are accepted, and how long they may take to send and to read."""
