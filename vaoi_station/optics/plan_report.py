"""Reports of a plan: text tables and JSON data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from vaoi_station.optics.constraint import Constraint
from vaoi_station.optics.optics_plan import Plan
from vaoi_station.optics.paper_example import PaperFigure
from vaoi_station.optics.remedies import Remedy, find_remedies

_VERDICTS = {True: "ok", False: "VIOLATED", None: "open"}


def plan_to_json(plan: Plan, figures: Sequence[PaperFigure] = ()) -> dict[str, Any]:
    """Convert a plan to JSON data.

    The keys are `requirements`, the sections of figures, `constraints`, `ok` and `remedies`. If `figures` of the
    comparison with the paper are given, they are under `paper`.
    """
    document = asdict(plan) | {"ok": plan.ok, "remedies": [asdict(r) for r in find_remedies(plan)]}
    return document | {"paper": [asdict(f) for f in figures]} if figures else document


def format_plan(plan: Plan, figures: Sequence[PaperFigure] = ()) -> str:
    """Format a plan as text tables: requirements, results, constraints, remedies, the paper's figures."""
    blocks = [
        _block("Requirements", _requirements(plan)),
        _block("Results", _results(plan)),
        _constraints(plan.constraints),
    ]
    if remedies := find_remedies(plan):
        blocks.append("What would mend what is violated\n" + _table([_remedy(r) for r in remedies], right={2}))
    if figures:
        blocks.append(_comparison(figures))
    return "\n\n".join(blocks) + "\n"


def _requirements(plan: Plan) -> list[tuple[str, str, str]]:
    q = plan.requirements
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
        ("capture of the longest board", "", _quantity(d.capture_duration_s, "s", 2)),
        ("rows of the longest board", "m", _number(d.rows, 0)),
        ("memory for one board", "", _megabytes(d.run_bytes)),
        (f"memory for {plan.requirements.runs_in_memory} boards", "", _megabytes(d.ring_bytes)),
    ]


def _constraints(constraints: Iterable[Constraint]) -> str:
    head = ("constraint", "", "value", "", "limit", "margin", "unit", "", "")
    rows = [head] + [
        (
            c.name,
            c.equation,
            _number(c.value, 3),
            c.relation,
            _number(c.limit, 3),
            _number(c.margin, 3, signed=True),
            c.unit,
            _VERDICTS[c.ok],
            c.note,
        )
        for c in constraints
    ]
    return "Constraints\n" + _table(rows, right={2, 4, 5})


def _remedy(remedy: Remedy) -> tuple[str, str, str, str]:
    option = f"--{remedy.requirement.replace('_', '-')}"
    new = f"violates {', '.join(remedy.violates)}" if remedy.violates else ""
    return remedy.constraint, option, _number(remedy.value), new


def _comparison(figures: Iterable[PaperFigure]) -> str:
    head = ("figure", "paper", "computed", "unit", "")
    rows = [head] + [(f.name, _number(f.paper), _number(f.computed, 4), f.unit, f.remark) for f in figures]
    return "The paper's figures (section 2.6)\n" + _table(rows, right={1, 2})


def _block(title: str, rows: Sequence[tuple[str, str, str]]) -> str:
    return f"{title}\n" + _table(rows, right=set())


def _table(rows: Sequence[tuple[str, ...]], right: set[int]) -> str:
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [c.rjust(w) if k in right else c.ljust(w) for k, (c, w) in enumerate(zip(row, widths, strict=True))]
        lines.append(("  " + "  ".join(cells)).rstrip())
    return "\n".join(lines)


def _quantity(value: float | None, unit: str, digits: int | None = None) -> str:
    return "open" if value is None else f"{_number(value, digits)} {unit}"


def _number(value: float | None, digits: int | None = None, *, signed: bool = False) -> str:
    if value is None:
        return "open"
    if digits is None:
        return f"{value:g}"
    # Trailing zeros would suggest a precision that the requirements do not have.
    text = f"{value:+.{digits}f}" if signed else f"{value:.{digits}f}"
    return text.rstrip("0").rstrip(".") if digits and "." in text else text


def _megabytes(value: int | None) -> str:
    return "open" if value is None else f"{value * 1e-6:.0f} MB"
