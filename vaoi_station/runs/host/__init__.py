"""Services of the host for the station's processes: set-up, logs, garbage collection, systemd, stop requests."""
