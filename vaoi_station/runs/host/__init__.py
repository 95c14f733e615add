"""What every process of the station needs from its host: set-up, logs, garbage collection, systemd, stop requests."""
