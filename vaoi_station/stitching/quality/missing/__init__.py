"""What the frames of a run do not show, and why: absent cameras, dark lights, unseen components."""
