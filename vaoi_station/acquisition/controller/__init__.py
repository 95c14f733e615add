"""The trigger controller: one interface, and one module or folder per backend."""
