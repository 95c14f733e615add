"""Let rendered boards pass: the virtual line, its faults, and the frames that were not rendered beforehand."""
