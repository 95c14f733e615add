"""Run processes: set-up, logs, garbage collection, systemd, requests to stop."""
