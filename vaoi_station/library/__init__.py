"""The public Python API: recordings, results and stations for programs that are not a station themselves.

`vaoi_station/__init__.py` lists what is public. Everything else in the package may change without notice.
"""
