"""The life of one board: from the light barrier to its matrices and pictures, one state table, one thread.

`control.coordinator` is what the REST service calls; `states.tables` holds the two state tables.
"""
