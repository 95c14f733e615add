"""Exposure and gain that change with every frame: the sets of a camera's sequencer, and what frames state of them."""
