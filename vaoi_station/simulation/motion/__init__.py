"""Move the board: belt, pulses, faults of one passage."""
