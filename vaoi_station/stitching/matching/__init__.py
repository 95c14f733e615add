"""Match frames: prepare them, choose corners, find them in a neighbouring frame to a few thousandths of a pixel."""
