"""The life of one board: from the light barrier to its matrices and pictures, one state table, one thread.

`facade` is what the REST service sees; `state` the two tables; `coordinator` the thread that follows them.
"""
