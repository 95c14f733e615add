"""Reports of a plan, as text tables and JSON data, and the example of the paper (section 2.6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from vaoi_station.optics.plan import Plan
from vaoi_station.optics.remedies import find_remedies
from vaoi_station.optics.requirements import Requirements

_VERDICTS = {True: "ok", False: "VIOLATED", None: "open"}
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
"""The requirements of section 2.6, which gives no circle of confusion, no d_min and no readout time. Its capture
duration of "up to 5 seconds" means 500 mm of travel at 100 mm/s: a board of 474 mm and a view of 26 mm."""


@dataclass(frozen=True)
class PaperFigure:
    """A figure printed in the paper (None if it omits it) and the same figure computed with its equations."""

    name: str
    paper: float | None
    computed: float | None
    unit: str
    remark: str = ""


def compare_with_paper(plan: Plan) -> tuple[PaperFigure, ...]:
    """List the printed figures of section 2.6 beside those of a plan for `PAPER`, with remarks on the rounding."""
    q, needed, lowest = plan.requirements, plan.array.cameras_needed, plan.motion.lowest_frame_rate_hz
    m_h, m_v = plan.array.multiplicity_h, plan.motion.multiplicity_v
    favour = "the paper rounds in its own favour"
    cameras = f"{favour}: {needed:.2f} are needed, that is 13; 12 reach m_h = {m_h:.3f}, not {q.multiplicity_h}"
    aperture = "stays open: the paper refers to section 2.6 for the circle of confusion, which gives none"
    rate = f"{favour}: {lowest:.2f} are needed; 8 reach m_v = {m_v:.2f}, not {q.multiplicity_v}"
    data = "12 cameras × 1392 × 1040 px × 8 bit × 8/s, with 1 Mbit = 10⁶ bit"
    duration = "the board's length is chosen to give the paper's 5 s, which it does not derive"
    return (
        PaperFigure("cameras needed", 12, needed, "", cameras),
        PaperFigure("focal length at d_max", 77.7, plan.lens.focal_length_mm, "mm"),
        PaperFigure("distance for the 75 mm lens", 483, plan.lens.working_distance_mm, "mm"),
        PaperFigure("f-number", None, plan.lens.f_number, "", aperture),
        PaperFigure("longest exposure", 250, plan.motion.longest_exposure_us, "µs"),
        PaperFigure("lowest frame rate", 8, lowest, "1/s", rate),
        PaperFigure("data rate", 1111.8, plan.data.data_rate_mbit_s, "Mbit/s", data),
        PaperFigure("capture duration", 5, plan.data.capture_duration_s, "s", duration),
    )


def plan_to_json(plan: Plan, figures: Sequence[PaperFigure] = ()) -> dict[str, Any]:
    """Convert a plan to JSON data: requirements, sections, constraints, `ok`, `remedies`, and figures as `paper`."""
    document = asdict(plan) | {"ok": plan.ok, "remedies": [asdict(r) for r in find_remedies(plan)]}
    return document | {"paper": [asdict(f) for f in figures]} if figures else document


def format_plan(plan: Plan, figures: Sequence[PaperFigure] = ()) -> str:
    """Format a plan as text tables: requirements, results, constraints, remedies, the paper's figures."""
    head = ("constraint", "", "value", "", "limit", "margin", "unit", "", "")
    constraints = [
        (c.name, c.equation, _number(c.value, 3), c.relation, _number(c.limit, 3), _number(c.margin, 3, "+"), c.unit,
         _VERDICTS[c.ok], c.note)
        for c in plan.constraints
    ]  # fmt: skip
    blocks = [
        "Requirements\n" + _table(_requirements(plan.requirements)),
        "Results\n" + _table(_results(plan)),
        "Constraints\n" + _table([head, *constraints], right={2, 4, 5}),
    ]
    if remedies := find_remedies(plan):
        rows = []
        for r in remedies:
            new = f"violates {', '.join(r.violates)}" if r.violates else ""
            rows.append((r.constraint, f"--{r.requirement.replace('_', '-')}", _number(r.value), new))
        blocks.append("What would mend what is violated\n" + _table(rows, right={2}))
    if figures:
        compared = [(f.name, _number(f.paper), _number(f.computed, 4), f.unit, f.remark) for f in figures]
        head_of_figures = ("figure", "paper", "computed", "unit", "")
        blocks.append("The paper's figures (section 2.6)\n" + _table([head_of_figures, *compared], right={1, 2}))
    return "\n\n".join(blocks) + "\n"


def _requirements(q: Requirements) -> list[tuple[str, str, str]]:
    return [
        ("widest board", "w", _quantity(q.width_mm, "mm")),
        ("longest board", "", _quantity(q.longest_board_mm, "mm")),
        ("resolution", "r", _quantity(q.resolution_px_per_mm, "px/mm")),
        ("multiplicity across, along", "m_h, m_v", f"{q.multiplicity_h:g}, {q.multiplicity_v:g}"),
        ("conveyor speed", "v", _quantity(q.speed_mm_s, "mm/s")),
        ("sensor", "p_h × p_v", f"{q.sensor_px_h} × {q.sensor_px_v} px, {q.bits_per_pixel} bit"),
        ("sensor width", "w_s", _quantity(q.sensor_width_mm, "mm")),
        ("distance", "d_min … d_max", f"{_number(q.distance_min_mm)} … {_quantity(q.distance_max_mm, 'mm')}"),
        ("depth of field", "d_f", _quantity(q.depth_of_field_mm, "mm")),
        ("circle of confusion", "c", _quantity(q.circle_of_confusion_mm, "mm")),
        ("motion blur at most", "τ", _quantity(q.blur_px, "px")),
    ]


def _results(plan: Plan) -> list[tuple[str, str, str]]:
    a, o, t, d = plan.array, plan.lens, plan.motion, plan.data
    return [
        ("cameras", "n", f"{a.cameras} ({a.cameras_needed:.2f} needed)"),
        ("view of one camera", "", f"{a.field_width_mm:.1f} × {a.field_height_mm:.1f} mm"),
        ("camera pitch", "", _quantity(a.camera_pitch_mm, "mm", 2)),
        ("focal length at d_max", "f", _quantity(o.focal_length_mm, "mm", 1)),
        ("focal length used", "f", _quantity(o.lens_mm, "mm", 1)),
        ("working distance", "d", _quantity(o.working_distance_mm, "mm", 0)),
        ("f-number", "N", _number(o.f_number, 1)),
        ("depth of field", "d_f", _quantity(o.depth_of_field_mm, "mm", 2)),
        ("Airy disc", "", _quantity(o.airy_disc_px, "px", 1)),
        ("exposure", "s", f"{t.exposure_us:.0f} µs (longest {t.longest_exposure_us:.0f} µs)"),
        ("frame rate", "t", f"{t.frame_rate_hz:.2f} frames/s (lowest {t.lowest_frame_rate_hz:.2f})"),
        ("trigger period", "1/t", f"{t.trigger_period_us:.0f} µs, {t.spare_time_us:.0f} µs of it spare"),
        ("board's step per row", "v/t", _quantity(t.row_step_mm, "mm", 2)),
        ("multiplicity reached", "m_h, m_v", f"{a.multiplicity_h:.3f}, {t.multiplicity_v:.3f}"),
        ("parallax, row to row", "", f"{t.parallax_px_per_mm:.2f} px per mm of height"),
        ("parallax, camera to camera", "", f"{a.parallax_px_per_mm:.2f} px per mm of height"),
        ("data rate", "", _quantity(d.data_rate_mbit_s, "Mbit/s", 1)),
        ("transfer of a row", "", _quantity(d.row_transfer_s and d.row_transfer_s * 1e3, "ms", 1)),
        ("capture of the longest board", "", _quantity(d.capture_duration_s, "s", 2)),
        ("rows of the longest board", "m", _number(d.rows, 0)),
        ("memory for one board", "", _megabytes(d.run_bytes)),
        (f"memory for {plan.requirements.runs_in_memory} boards", "", _megabytes(d.ring_bytes)),
    ]


def _table(rows: Sequence[tuple[str, ...]], right: set[int] | None = None) -> str:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    cells = [
        [c.rjust(w) if k in (right or ()) else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        for row in rows
    ]
    return "\n".join(("  " + "  ".join(row)).rstrip() for row in cells)


def _quantity(value: float | None, unit: str, digits: int | None = None) -> str:
    return "open" if value is None else f"{_number(value, digits)} {unit}"


def _number(value: float | None, digits: int | None = None, sign: str = "") -> str:
    """Format without trailing zeros: they would suggest a precision that the requirements do not have."""
    if value is None:
        return "open"
    if digits is None:
        return f"{value:g}"
    text = f"{value:{sign}.{digits}f}"
    return text.rstrip("0").rstrip(".") if digits and "." in text else text


def _megabytes(value: int | None) -> str:
    return "open" if value is None else f"{value * 1e-6:.0f} MB"
