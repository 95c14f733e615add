"""Keep finished runs and their results, find the frames that show a component, and keep the event log."""
