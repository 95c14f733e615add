"""What `vaoi bench` measures: ratios in one run, on frames in memory, one thread."""
