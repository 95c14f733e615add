"""station.toml as data: its keys with documentation and limits, all its faults, edits that keep the rest."""
