"""The commands for planning, artwork, the virtual rig and benchmarks."""
