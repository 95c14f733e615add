"""Commands on the runs of many stations."""
