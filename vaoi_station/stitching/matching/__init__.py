"""Match two frames: prepare them, choose corners in one, find these in the other to a few thousandths of a pixel."""
