"""What clients meet in tests: a scripted web server, and certificates for TLS."""
