"""The motion of boards on the belt, the times of barrier and pulses, and the faults of a passage."""
