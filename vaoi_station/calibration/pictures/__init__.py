"""Pictures of calibrations: marks and residuals in each frame, and the difference of two calibrations."""
