"""The sections of the report that list figures: summary, motion, seams and fiducials, frames, provenance, data."""

from __future__ import annotations

import hashlib
import json
import platform
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.results import stitch_document
from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing import (
    Section,
    drawing,
    facts,
    figures,
    folded,
    label,
    number,
    plot,
    round_up,
    table,
    tag,
    text,
    title,
)
from vaoi_station.reporting.stitched_run import StitchedRun
from vaoi_station.stitching.adjustment.motion import measured_velocity
from vaoi_station.stitching.matching.evidence import Detections, FrameKey
from vaoi_station.stitching.quality.findings import Findings


def head(stitched: StitchedRun, name: str) -> str:
    """Show the run's name, its verdict, and the reasons for the verdict."""
    result, board_type = stitched.result, stitched.opened.setup.board_type
    heading = tag("h1", text(name), tag("span", text(result.status), class_="verdict"))
    what = f"board type {board_type.name}" if board_type else "no board type"
    size = " × ".join(
        f"{count} {noun}{'' if count == 1 else 's'}"
        for count, noun in ((stitched.cameras, "camera"), (stitched.head.rows, "row"))
    )
    line = tag("p", text(f"{what} · {size} · method {result.method}"))
    reasons = tag("ul", *(tag("li", text(r)) for r in result.reasons)) if result.reasons else ""
    return tag("header", heading, line, reasons, class_=str(result.status))


def key_numbers(stitched: StitchedRun) -> Section:
    """List the numbers on which the verdict is based."""
    q, skipped = stitched.result.quality, stitched.result.skipped_boards
    residual, belt, parts, scale = q["residual_px"], q["belt"], q["component_sigma_px"], q["scale_error"]
    worst = f" ({max(parts, key=parts.__getitem__)})" if parts else ""
    measured = belt["measured_mm_s"]
    accuracy = [
        ("σ of positions, worst view", _with_unit(q["cad_sigma_px"], "px") + worst),
        ("links: median residual", _with_unit(residual["median"], "px")),
        ("links: noise floor", _with_unit(residual["scatter"], "px")),
        ("σ₀ of the adjustment", number(residual["sigma0"], 2) + " (1: as predicted)"),
        ("scale against CAD", "–" if scale is None else number(scale * 1e6, 0) + " ppm"),
        (
            "belt, measured",
            f"{number(np.hypot(*measured))} mm/s ({number(belt['speed_error'] * 100, 2)} %)" if measured else "–",
        ),
        ("belt, nominal", f"{number(np.hypot(*belt['nominal_mm_s']))} mm/s"),
        ("contrast along the outline", _with_unit(q["outline_contrast"], "grey levels", 1)),
    ]
    names = {
        "rows": "links from row to row",
        "neighbours": "links between cameras",
        "fiducials": "detections of fiducials",
        "fixture": "detections of fixture marks",
        "reference": "points of the reference",
    }
    present, frames = stitched.opened.present, stitched.cameras * stitched.head.rows
    placed = sum(bool(stitched.findings.placed[row]) for _, row in present)
    linked = sum(len(p.links.a_px) > 0 for p in stitched.pairs)
    views, unseen = stitched.result.components or {}, q["unseen"]
    evidence = [
        ("frames", f"{len(present)} of {frames} delivered, {placed} placed"),
        ("pairs of frames linked", f"{linked} of {len(stitched.pairs)}"),
        *((names[kind], f"{c['used']} used of {c['found']}") for kind, c in q["links"].items() if c["found"]),
        ("components in view", f"{sum(map(bool, views.values()))} of {len(views)}" if views else "–"),
        (
            "components seen too little",
            ", ".join(f"{address} ({u['coverage']:.0%}, {u['cause']})" for address, u in unseen.items()) or "none",
        ),
        *([("boards skipped", ", ".join(skipped))] if skipped else []),
        ("components with a height", str(len(q["heights_mm"]))),
    ]
    return Section("numbers", "Key numbers", "", tag("div", facts(accuracy), facts(evidence), class_="columns"))


def _with_unit(value: float | None, unit: str, digits: int = 3) -> str:
    return "–" if value is None else f"{number(value, digits)} {unit}"


_FEW_ROWS, _NARROW_PX, _WIDE_PX = 24, 374.0, 1150.0
"""Up to `_FEW_ROWS` rows, three narrow curves stand side by side; with more rows, the curves are wide. Widths in px."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Position of the board in each row minus the position on a belt of constant velocity, with standard deviations."""

    velocity_mm_s: Floats
    """Velocity (2,) of the belt: the measured one, else the nominal one."""
    value: Floats
    """Deviations (m, 3) of m rows: along and across the motion in µm; yaw in mrad, from tester x towards y."""
    sigma: Floats
    """Standard deviations (m, 3) of `value`, in the same units."""
    held: NDArray[np.bool_]
    """Per row: True if evidence determines its motion, False if only the nominal motion does."""


def deviation(f: Findings) -> Deviation:
    """Compute the deviation of every row, at the centre of the array, relative to row 0."""
    motion, times_s = f.adjusted.motion, f.problem.times_s
    # The longest chain of linked rows gives the best speed; separate chains have no common origin.
    velocity = measured_velocity(motion, times_s, max(f.connected_groups, key=len)) if f.connected_groups else None
    if velocity is None or not np.hypot(*velocity) > 0:
        velocity = np.asarray(f.problem.velocity_mm_s, dtype=np.float64)
    speed = float(np.hypot(*velocity))
    along = velocity / speed if speed else np.array([1.0, 0.0])
    turn = np.array([along, (-along[1], along[0])])
    # `Motion` maps from the row to the board, the inverse of D_j: the displacement of the board has the other sign.
    off = (-motion.shift - velocity * (times_s - times_s[0])[:, None]) @ turn.T
    yaw, places = f.adjusted.covariance[:, 0, 0], turn @ f.adjusted.covariance[:, 1:3, 1:3] @ turn.T
    variances = np.column_stack([places[:, 0, 0], places[:, 1, 1], yaw]) * 1e6
    held = np.isin(np.arange(len(times_s)), [int(r) for group in f.connected_groups for r in group])
    value = np.column_stack([off, -motion.angle]) * 1e3
    return Deviation(velocity, value, np.sqrt(np.maximum(variances, 0)), held)


def row_motion(stitched: StitchedRun) -> Section:
    """Draw how rows deviate from uniform motion: along the belt, across it, in rotation."""
    d, f = deviation(stitched.findings), stitched.findings
    names = (("along the belt", "µm"), ("across the belt", "µm"), ("yaw", "mrad"))
    width = _NARROW_PX if stitched.head.rows <= _FEW_ROWS else _WIDE_PX
    drawings = [
        (plot(name, unit, width, d.value[:, k], d.sigma[:, k], d.held), text(f"{name}, {unit}, over rows"))
        for k, (name, unit) in enumerate(names)
    ]
    rows = []
    for j, (value, sigma) in enumerate(zip(d.value, d.sigma, strict=True)):
        pairs = [number(v, digits) for k, digits in enumerate((1, 1, 4)) for v in (value[k], sigma[k])]
        placed_by = "evidence" if d.held[j] else "nominal motion"
        rows.append([str(j), number(f.problem.times_s[j], 4), *pairs, placed_by, number(f.sigma.rows_px[j])])
    columns = ["row", "time s", "along µm", "σ", "across µm", "σ", "yaw mrad", "σ", "placed by", "σ in the image px"]
    x, y = d.velocity_mm_s
    lead = (
        f"Position of the board in each row minus that of a belt of constant velocity ({number(x)}, {number(y)}) mm/s, "
        "at the centre of the array, relative to row 0. The band is ±1 σ. Hollow points are rows that only the nominal "
        "motion places."
    )
    listed = folded("figures of every row", table(columns, rows, 1))
    return Section("motion", "Row motion against the belt", lead, figures(*drawings) + listed)


def seams(stitched: StitchedRun) -> Section:
    """Show how well the links of each pair of neighbouring cameras agree, over all rows."""
    f, rows = stitched.findings, []
    for i in range(stitched.cameras - 1):
        pairs = [p for p in stitched.pairs if p.links.task.kind == "neighbours" and p.a[0] == i]
        used = sum(p.used for p in pairs)
        # The mean over all rows weighs each pair of frames by its number of links.
        squares = [p.residual_px**2 * p.used for p in pairs if p.residual_px is not None]
        rms = (sum(squares) / used) ** 0.5 if used else None
        strange = f.non_overlapping_pairs.get((i, i + 1))
        note = f"the frames do not overlap in {strange} rows" if strange else "" if used else "no links"
        median = number(f.seams_px.get((i, i + 1)))
        rows.append([f"{i} – {i + 1}", str(used), str(len(pairs)), median, number(rms), note])
    if not rows:
        return Section.empty("seams", "Seams between cameras", "There is one camera only.")
    lead = (
        "The median residual on the bare board shows whether two cameras are still where they were calibrated; “–” "
        "with fewer than twelve links."
    )
    columns = ["cameras", "links", "pairs of frames", "median residual px", "rms px", ""]
    return Section("seams", "Seams between cameras", lead, table(columns, rows, 1))


def fiducials(stitched: StitchedRun) -> Section:
    """Compare the detected positions of fiducials with those that the result predicts."""
    listed = stitched.result.quality["fiducials"]
    if not listed:
        why = "The board was not found." if stitched.opened.setup.board_type else "There is no board type."
        return Section.empty("fiducials", "Fiducials", why)
    rows = []
    for f in listed:
        residual = f["residual_px"]
        lengths = (*residual, float(np.hypot(*residual))) if residual else (None, None, None)
        rows.append([f["name"], str(f["sightings"]), *(number(v, 4) for v in lengths)])
    columns = ["fiducial", "detections", "mean x px", "mean y px", "length px"]
    lead = (
        "Residuals of single detections along the tester's axes. Two fiducials determine the position; more check it."
    )
    return Section("fiducials", "Fiducials", lead, figures((_target(stitched), ""), (table(columns, rows, 1), "")))


_SIDE = 300.0
_COLOURS = ("#22456b", "#c0561a", "#18603f", "#7a2a6b", "#6b6b18", "#1a7f8c")


def _target(stitched: StitchedRun) -> str:
    """Draw the residuals of all detections as dots around the point of zero residual."""
    f = stitched.findings
    points = f.problem.fiducials
    if points is None or f.plane is None or not (points.which >= 0).any():
        return ""
    mine = points.which >= 0
    off, which, rows = f.adjusted.fiducial_px[mine], points.which[mine], points.row[mine]
    reach = round_up(max(float(np.hypot(*off.T).max()), 0.02))
    middle = _SIDE / 2
    scale = (middle - 16) / reach
    content = []
    for r in (reach / 2, reach):
        content.append(tag("circle", cx=middle, cy=middle, r=r * scale, fill="none", stroke="#c9ced3"))
        content.append(label(middle + 3, middle - r * scale - 3, f"{r:g} px", class_="faint"))
    content.append(tag("line", x1=0, x2=_SIDE, y1=middle, y2=middle, stroke="#e2e6e9"))
    content.append(tag("line", x1=middle, x2=middle, y1=0, y2=_SIDE, stroke="#e2e6e9"))
    for (x, y), n, row in zip(off, which, rows, strict=True):
        tooltip = title(f"{f.plane.board_type.fiducials[n].name}, row {row}: ({number(x)}, {number(y)}) px")
        at = {"cx": float(middle + x * scale), "cy": float(middle + y * scale)}
        content.append(tag("circle", tooltip, **at, r=4.0, fill=_COLOURS[n % len(_COLOURS)], fill_opacity=0.75))
    return drawing(_SIDE, _SIDE, *content, label="residuals of fiducials")


_WIDTH_PX = 120


def picture_store(stitched: StitchedRun) -> str:
    """Return all thumbnails as SVG definitions. Sections refer to them, so that the file holds each only once."""
    images = "".join(
        tag("image", id=picture_id(key), width=t.width, height=t.height, href=t.uri, preserveAspectRatio="none")
        for key, t in stitched.thumbnails.items()
    )
    return tag("svg", tag("defs", images), width=0, height=0, class_="store", aria_hidden="true")


def picture_id(key: FrameKey) -> str:
    """Return the id of a frame's thumbnail, by which the page refers to it."""
    return f"f{key[0]}-{key[1]}"


def frame_table(stitched: StitchedRun) -> Section:
    """Show the state of every frame, in a table of rows and cameras."""
    links: Counter[FrameKey] = Counter()
    for pair in stitched.pairs:
        links[pair.a] += pair.used
        links[pair.b] += pair.used
    cameras = range(stitched.cameras)
    head = tag("tr", tag("th"), *(tag("th", text(f"camera {i}")) for i in cameras))
    body = "".join(
        tag("tr", tag("th", text(f"row {j}")), *(_cell(stitched, (i, j), links[i, j]) for i in cameras))
        for j in range(stitched.head.rows)
    )
    film = tag("div", tag("table", tag("thead", head), tag("tbody", body), class_="film"), class_="scroll tall")
    bad = [[str(c), str(r), verdict, cause] for (c, r), (verdict, cause) in sorted(stitched.causes.items())]
    if bad:
        film += folded(f"frames that are not ok: {len(bad)}", table(["camera", "row", "state", "cause"], bad, 4))
    lead = (
        "The number counts links with weight in the adjustment. A dotted line marks a frame without such links; the "
        "other frames of its row place it, or the nominal motion. A dashed line marks a frame that was not delivered."
    )
    return Section("frames", "Frames", lead, film)


def _cell(stitched: StitchedRun, key: FrameKey, links: int) -> str:
    if key in stitched.causes:
        verdict, cause = stitched.causes[key]
        return tag("td", text(verdict), class_="bad", title=cause)
    t = stitched.thumbnails[key]
    width = min(_WIDTH_PX, t.width)
    use = tag("use", href=f"#{picture_id(key)}")
    shown = tag("svg", use, viewBox=f"0 0 {t.width} {t.height}", width=width, height=width * t.height / t.width)
    alone = None if links else "alone"
    return tag("td", shown, text(links or "no links"), class_=alone, title=f"camera {key[0]}, row {key[1]}")


def timings(stitched: StitchedRun) -> Section:
    """List the wall times of tasks and conclusion, measured on one core for the report."""
    spent = [("task: ", stitched.task_ms), ("conclusion: ", stitched.result.quality["timings_ms"])]
    rows = [[what + kind, number(ms, 1)] for what, times in spent for kind, ms in times.items()]
    lead = (
        "Wall time of this stitch, which was made for the report. First the tasks, which a station performs while the "
        "board passes, with reading of frames from disk; then the conclusion after the board has left."
    )
    return Section("timings", "Timings", lead, table(["stage", "ms"], rows, 1))


def identity(stitched: StitchedRun) -> Section:
    """List software versions and input files."""
    o, q, known = stitched.opened, stitched.result.quality, stitched.opened.calibration
    made = [
        ("software", str(q["software"])),
        ("OpenCV, NumPy, Python", f"{q['opencv']}, {np.__version__}, {platform.python_version()}"),
        ("method", stitched.result.method),
        ("reference", o.reference.recording.directory.name if o.reference else "none"),
    ]
    rests_on = [
        ("recording", digest(o.recording.directory / "recording.json")),
        ("calibration", digest(o.calibration_path)),
        ("… created", known.created or "not stated"),
        ("… working distance", "not known" if (d := known.working_distance_mm) is None else f"{number(d, 1)} mm"),
        ("… residuals", ", ".join(map(number, known.residual_px)) + " px" if known.residual_px else "–"),
        ("board type", digest(o.board_path) if o.board_path else "none"),
    ]
    body = tag("div", facts(made), facts(rests_on), class_="columns")
    return Section("identity", "Identity", "Digests are the first 16 digits of SHA-256 of the files.", body)


def digest(path: Path) -> str:
    """Return the name of a file, and the first 16 digits of its SHA-256."""
    return f"{path.name} · {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


def data_block(stitched: StitchedRun) -> str:
    """Return everything except the frames as one JSON object in a script element."""
    # "</script>" inside a text would end the element; an escaped "<" cannot.
    content = json.dumps(document(stitched), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return tag("script", content, type="application/json", id="run")


def document(stitched: StitchedRun) -> dict[str, Any]:
    """Return recording, calibration, board type, result, and all links and detections with their residuals."""
    o, d = stitched.opened, deviation(stitched.findings)
    board_type = o.setup.board_type
    return {
        "format": "vaoi-report",
        "version": 1,
        "recording": o.recording.head.model_dump(mode="json", exclude_none=True),
        "calibration": o.calibration.model_dump(mode="json", exclude_none=True),
        "board_type": board_type.model_dump(mode="json", exclude_none=True) if board_type else None,
        "result": stitch_document(stitched.result),
        "row_motion": {
            "velocity_mm_s": _short(d.velocity_mm_s),
            "along_um_across_um_yaw_mrad": _short(d.value),
            "sigma": _short(d.sigma),
            "held": d.held.tolist(),
        },
        "links": {name: _short(values) for name, values in link_arrays(stitched).items()},
        "sightings": {name: _short(values) for name, values in detection_arrays(stitched).items()},
        "task_ms": {kind: round(ms, 3) for kind, ms in stitched.task_ms.items()},
    }


def link_arrays(stitched: StitchedRun) -> dict[str, NDArray[Any]]:
    """Return all links as arrays of one length k: frames, positions in raw px, information, weight and residual.

    `residual_px` is along the tester's axes. `component` is an index into the board type's components; −1 stands for
    the bare board.
    """
    f = stitched.findings
    o, a = f.problem.links, f.adjusted
    tasks = [e.task for e in o.groups]
    frames = np.array([(*t.a, *(t.b or t.a), t.kind == "neighbours") for t in tasks], dtype=np.int32).reshape(-1, 5)
    frames = frames[o.group]
    return {
        "a": frames[:, 0:2],
        "b": frames[:, 2:4],
        "between_cameras": frames[:, 4],
        "a_px": np.concatenate([np.zeros((0, 2)), *(e.a_px for e in o.groups)]),
        "b_px": np.concatenate([np.zeros((0, 2)), *(e.b_px for e in o.groups)]),
        "information": np.concatenate([np.zeros((0, 2, 2)), *(e.information for e in o.groups)]),
        "score": np.concatenate([np.zeros(0), *(e.score for e in o.groups)]),
        "residual_px": a.link_px,
        "weight": a.weight,
        "component": f.problem.component.astype(np.int32),
    }


def detection_arrays(stitched: StitchedRun) -> dict[str, NDArray[Any]]:
    """Return all detections of marks as arrays with one entry each, before they are assigned to fiducials."""
    seen = [e for e in stitched.evidence if isinstance(e, Detections)]
    keys = np.array([e.task.a for e in seen], dtype=np.int32).reshape(-1, 2)
    return {
        "frame": np.repeat(keys, [len(e.px) for e in seen], axis=0),
        "px": np.concatenate([np.zeros((0, 2)), *(e.px for e in seen)]),
        "sigma_px": np.concatenate([np.zeros(0), *(e.sigma_px for e in seen)]),
        "score": np.concatenate([np.zeros(0), *(e.score for e in seen)]),
        "kind": np.concatenate([np.zeros(0, dtype=np.int32), *(e.kind.astype(np.int32) for e in seen)]),
    }


def _short(values: NDArray[Any]) -> Any:
    """Return values as nested lists. Decimals are rounded to six significant digits; integers stay integers."""
    if values.dtype.kind in "iu":
        return values.tolist()
    if values.ndim > 1:
        return [_short(v) for v in values]
    return [float(f"{v:.6g}") for v in values]
