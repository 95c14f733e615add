"""Keep finished runs: results, the event log, the components of a run."""
