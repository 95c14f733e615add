"""The fork server, which forks the workers, and the station's side of it."""
