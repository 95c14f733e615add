"""Pictures for callers who wait: most are rendered by workers, small ones by the station itself."""
