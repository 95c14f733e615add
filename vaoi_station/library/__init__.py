"""The public Python API: recordings, results and running stations, for other programs.

`vaoi_station/__init__.py` lists what is public. Everything else in the package may change without notice.
"""
