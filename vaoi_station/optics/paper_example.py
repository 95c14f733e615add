"""The paper's example (section 2.6): its requirements, and its printed figures beside computed ones."""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.optics.optics_plan import Plan
from vaoi_station.optics.requirements import Requirements

PAPER = Requirements(
    width_mm=400.0,
    resolution_px_per_mm=40.0,
    speed_mm_s=100.0,
    sensor_px_h=1392,
    sensor_px_v=1040,
    sensor_width_mm=6.4,
    distance_max_mm=500.0,
    multiplicity_h=1.05,
    multiplicity_v=2.1,
    depth_of_field_mm=10.0,
    blur_px=1.0,
    lens_mm=75.0,
    cameras=12,
    frame_rate_hz=8.0,
    longest_board_mm=474.0,
)
"""The requirements of section 2.6. The section gives no circle of confusion, no d_min and no readout time. Its capture
duration of "up to 5 seconds" means 500 mm of travel at 100 mm/s: a board of 474 mm and a view of 26 mm."""


@dataclass(frozen=True)
class PaperFigure:
    """A figure printed in the paper and the same figure computed with the paper's equations."""

    name: str
    paper: float | None
    """The figure as printed in the paper; None if the paper omits it."""
    computed: float | None
    unit: str
    remark: str = ""


def compare_with_paper(plan: Plan) -> tuple[PaperFigure, ...]:
    """List the printed figures of section 2.6 beside those of a plan for `PAPER`, with remarks on the rounding."""
    q, needed, lowest = plan.requirements, plan.array.cameras_needed, plan.motion.lowest_frame_rate_hz
    return (
        PaperFigure(
            "cameras needed",
            12,
            needed,
            "",
            f"the paper rounds in its own favour: {needed:.2f} are needed, that is 13; "
            f"12 reach m_h = {plan.array.multiplicity_h:.3f}, not {q.multiplicity_h}",
        ),
        PaperFigure("focal length at d_max", 77.7, plan.lens.focal_length_mm, "mm"),
        PaperFigure("distance for the 75 mm lens", 483, plan.lens.working_distance_mm, "mm"),
        PaperFigure(
            "f-number",
            None,
            plan.lens.f_number,
            "",
            "stays open: the paper refers to section 2.6 for the circle of confusion, which gives none",
        ),
        PaperFigure("longest exposure", 250, plan.motion.longest_exposure_us, "µs"),
        PaperFigure(
            "lowest frame rate",
            8,
            lowest,
            "1/s",
            f"the paper rounds in its own favour: {lowest:.2f} are needed; "
            f"8 reach m_v = {plan.motion.multiplicity_v:.2f}, not {q.multiplicity_v}",
        ),
        PaperFigure(
            "data rate",
            1111.8,
            plan.data.data_rate_mbit_s,
            "Mbit/s",
            "12 cameras × 1392 × 1040 px × 8 bit × 8/s, with 1 Mbit = 10⁶ bit",
        ),
        PaperFigure(
            "capture duration",
            5,
            plan.data.capture_duration_s,
            "s",
            "the board's length is chosen to give the paper's 5 s, which it does not derive",
        ),
    )
