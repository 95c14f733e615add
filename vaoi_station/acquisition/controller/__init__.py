"""The trigger controller: one interface, and one module or folder for each kind of controller."""
