"""The virtual rig: the station's real backends on devices that are emulated down to registers and packets."""
