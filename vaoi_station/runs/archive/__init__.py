"""Keep finished runs: their results, the components they show, and the event log."""
