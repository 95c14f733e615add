"""Mosaics of runs whose frames are in memory, rendered on demand: plans are kept, tiles are not.

The first tile of a mosaic waits until a worker has planned it from all frames of the run. Every other tile needs the
few frames that it shows.
"""
