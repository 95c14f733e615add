"""Drive cameras: one interface and one module per backend; backends do not import one another."""
