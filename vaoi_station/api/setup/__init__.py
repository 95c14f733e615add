"""Setting a station up over REST: its calibration.

All of it needs the scope admin, and changes no other files than those that station.toml names.
"""
