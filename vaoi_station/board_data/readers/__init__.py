"""One reader per format of board data; each returns a `Design`."""
