"""Move boards: the belt, the times of barrier and pulses, and what goes wrong."""
