"""The optics design of section 2 of the paper: cameras, lenses, exposures and pulses for a line.

One function for each equation; a plan computes all figures and checks all constraints for given requirements.
"""

from vaoi_station.optics.equations import (
    achieved_multiplicity_h,
    achieved_multiplicity_v,
    airy_disc_px,
    buffer_bytes,
    camera_pitch_mm,
    cameras_needed,
    capture_duration_s,
    data_rate_mbit_s,
    depth_of_field_mm,
    f_number,
    focal_length_mm,
    frame_bytes,
    longest_exposure_us,
    lowest_frame_rate_hz,
    motion_blur_px,
    parallax_px,
    rows_per_board,
    spare_time_us,
    working_distance_mm,
)
from vaoi_station.optics.plan import Constraint, Plan, make_plan
from vaoi_station.optics.requirements import Requirements

__all__ = [
    "Constraint", "Plan", "Requirements", "achieved_multiplicity_h", "achieved_multiplicity_v", "airy_disc_px",
    "buffer_bytes", "camera_pitch_mm", "cameras_needed", "capture_duration_s", "data_rate_mbit_s", "depth_of_field_mm",
    "f_number", "focal_length_mm", "frame_bytes", "longest_exposure_us", "lowest_frame_rate_hz", "make_plan",
    "motion_blur_px", "parallax_px", "rows_per_board", "spare_time_us", "working_distance_mm",
]  # fmt: skip
