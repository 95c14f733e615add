"""The trigger controller: one interface, one module per backend."""
