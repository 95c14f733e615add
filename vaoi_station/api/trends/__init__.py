"""REST: how the figures of boards develop, and how two spans of time differ."""
