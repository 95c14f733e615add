"""One-file packages: backup and restore of a station, export and import of a run."""
