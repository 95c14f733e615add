"""More than one station: runs of a plant in archives, evaluated again on many machines.

Nothing here is needed to film a board. Libraries of the extra `plant` are imported by the functions that use them.
"""
