"""Move boards past the emulated devices, with faults."""
