"""Let rendered boards pass the cameras: the virtual line, its faults, and frames that are rendered on demand."""
