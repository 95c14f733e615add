"""Calibration of the camera array from one row of frames of a board of known marks; section 3.2 of the paper.

It contains the artwork of such boards, the detection and identification of marks, the least-squares fit of N_i and lens
with covariances, and the difference of two calibrations.
"""

from vaoi_station.calibration.array_calibration import Outcome, calibrate
from vaoi_station.calibration.camera_fit import CameraResult, Limits

__all__ = ["CameraResult", "Limits", "Outcome", "calibrate"]
