"""How the figures of boards develop: kept longer than the runs, thinned for long spans, compared between two spans."""
