"""The states of the station and of runs, and the schemas of the documents that describe both to callers."""
