"""Match two frames: prepare them, choose corners in the first, and find these in the second to 0.01 px or better."""
