"""The optics design of section 2 of the paper: cameras, lenses, exposures and pulses for a line.

The room has one function for each numbered equation, and functions for data rates and times. A plan computes all
figures and checks all constraints for given requirements. The room uses no files or devices.
"""

from vaoi_station.optics.array_equations import (
    achieved_multiplicity_h,
    camera_pitch_mm,
    cameras_needed,
    field_of_view_mm,
)
from vaoi_station.optics.constraint import Constraint
from vaoi_station.optics.data_rates import buffer_bytes, data_rate_mbit_s, frame_bytes
from vaoi_station.optics.lens_equations import (
    airy_disc_px,
    depth_of_field_mm,
    f_number,
    focal_length_mm,
    working_distance_mm,
)
from vaoi_station.optics.motion_equations import (
    longest_exposure_us,
    lowest_frame_rate_hz,
    motion_blur_px,
    parallax_px,
    parallax_px_per_mm,
)
from vaoi_station.optics.optics_plan import Plan, make_plan
from vaoi_station.optics.pulse_timing import (
    achieved_multiplicity_v,
    capture_duration_s,
    rows_per_board,
    spare_time_us,
    trigger_period_us,
)
from vaoi_station.optics.requirements import Requirements

__all__ = [
    "Constraint",
    "Plan",
    "Requirements",
    "achieved_multiplicity_h",
    "achieved_multiplicity_v",
    "airy_disc_px",
    "buffer_bytes",
    "camera_pitch_mm",
    "cameras_needed",
    "capture_duration_s",
    "data_rate_mbit_s",
    "depth_of_field_mm",
    "f_number",
    "field_of_view_mm",
    "focal_length_mm",
    "frame_bytes",
    "longest_exposure_us",
    "lowest_frame_rate_hz",
    "make_plan",
    "motion_blur_px",
    "parallax_px",
    "parallax_px_per_mm",
    "rows_per_board",
    "spare_time_us",
    "trigger_period_us",
    "working_distance_mm",
]
