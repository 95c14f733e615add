"""Control the station. Only the coordinator's thread changes its state; other threads send it requests and reports."""
