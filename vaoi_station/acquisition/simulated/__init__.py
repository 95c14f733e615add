"""Replace line, cameras and controller by the digital twin or by recordings."""
