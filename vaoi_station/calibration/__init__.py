"""Calibration of the camera array: N_i and lenses from one look at a board of known marks; section 3.2 of the paper.

Artwork of such a board, marks found and identified by themselves, camera matrices by least squares with
their covariance, and the map of the difference of two calibrations.
"""

from vaoi_station.calibration.array_calibration import Outcome, calibrate
from vaoi_station.calibration.camera_fit import CameraResult, Limits

__all__ = ["CameraResult", "Limits", "Outcome", "calibrate"]
