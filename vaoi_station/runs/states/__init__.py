"""Define the states of station and run, and the documents that describe them to callers."""
