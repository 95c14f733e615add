"""The sections of the report that list figures: summary, motion, seams and fiducials, frames, provenance, data."""

from __future__ import annotations

import hashlib
import json
import platform
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.results import stitch_document
from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing import (
    Plot,
    Section,
    drawing,
    facts,
    figures,
    folded,
    label,
    number,
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
    status = str(stitched.result.status)
    heading = tag("h1", text(name), tag("span", text(status), class_="verdict"))
    board_type = stitched.opened.setup.board_type
    what = f"board type {board_type.name}" if board_type else "no board type"
    size = f"{_many(stitched.cameras, 'camera')} × {_many(stitched.head.rows, 'row')}"
    line = tag("p", text(f"{what} · {size} · method {stitched.result.method}"))
    reasons = tag("ul", *(tag("li", text(r)) for r in stitched.result.reasons)) if stitched.result.reasons else ""
    return tag("header", heading, line, reasons, class_=status)


def key_numbers(stitched: StitchedRun) -> Section:
    """Return the section that lists the numbers on which the verdict is based."""
    q = stitched.result.quality
    left, right = facts(_accuracy(q)), facts(_evidence(stitched, q))
    return Section("numbers", "Key numbers", "", tag("div", left, right, class_="columns"))


def _accuracy(q: dict[str, Any]) -> list[tuple[str, str]]:
    residual, belt = q["residual_px"], q["belt"]
    parts = q["component_sigma_px"]
    worst = max(parts, key=lambda k: parts[k]) if parts else None
    measured = belt["measured_mm_s"]
    speed = None if measured is None else (measured[0] ** 2 + measured[1] ** 2) ** 0.5
    nominal = (belt["nominal_mm_s"][0] ** 2 + belt["nominal_mm_s"][1] ** 2) ** 0.5
    error = belt["speed_error"]
    scale = q["scale_error"]
    return [
        ("σ of positions, worst view", _px(q["cad_sigma_px"]) + (f" ({worst})" if worst else "")),
        ("links: median residual", _px(residual["median"])),
        ("links: noise floor", _px(residual["scatter"])),
        ("σ₀ of the adjustment", number(residual["sigma0"], 2) + " (1: as predicted)"),
        ("scale against CAD", "–" if scale is None else number(scale * 1e6, 0) + " ppm"),
        ("belt, measured", "–" if speed is None else f"{number(speed)} mm/s ({number(error * 100, 2)} %)"),
        ("belt, nominal", f"{number(nominal)} mm/s"),
        ("contrast along the outline", _grey(q["outline_contrast"])),
    ]


def _evidence(stitched: StitchedRun, q: dict[str, Any]) -> list[tuple[str, str]]:
    names = {
        "rows": "links from row to row",
        "neighbours": "links between cameras",
        "fiducials": "detections of fiducials",
        "fixture": "detections of fixture marks",
        "reference": "points of the reference",
    }
    found = {kind: c for kind, c in q["links"].items() if c["found"]}
    counts = [(names.get(kind, kind), f"{c['used']} used of {c['found']}") for kind, c in found.items()]
    pairs = stitched.pairs
    linked = sum(1 for p in pairs if len(p.links.a_px))
    present, frames = len(stitched.opened.present), stitched.cameras * stitched.head.rows
    views = stitched.result.components or {}
    return [
        ("frames", f"{present} of {frames} delivered, {_placed(stitched)} placed"),
        ("pairs of frames linked", f"{linked} of {len(pairs)}"),
        *counts,
        ("components in view", f"{sum(1 for v in views.values() if v)} of {len(views)}" if views else "–"),
        ("components seen too little", _unseen(q["unseen"])),
        *((("boards skipped", ", ".join(stitched.result.skipped_boards)),) if stitched.result.skipped_boards else ()),
        ("components with a height", str(len(q["heights_mm"]))),
    ]


def _unseen(unseen: dict[str, Any]) -> str:
    return ", ".join(f"{address} ({u['coverage']:.0%}, {u['cause']})" for address, u in unseen.items()) or "none"


def _placed(stitched: StitchedRun) -> int:
    placed, present = stitched.findings.placed, stitched.opened.present
    return sum(1 for _, row in present if placed[row])


def _many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"


def _px(value: float | None) -> str:
    return "–" if value is None else f"{number(value)} px"


def _grey(value: float | None) -> str:
    return "–" if value is None else f"{number(value, 1)} grey levels"


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
    held: tuple[bool, ...]
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
    m = len(times_s)
    blocks = f.adjusted.covariance[:, :3, :3]
    places = np.array([np.diag(turn @ b[1:, 1:] @ turn.T) for b in blocks])
    yaw = np.array([b[0, 0] for b in blocks])
    sigma = np.sqrt(np.maximum(np.column_stack([places * 1e6, yaw * 1e6]), 0))
    value = np.column_stack([off * 1e3, -motion.angle * 1e3])
    rows = {int(r) for group in f.connected_groups for r in group}
    return Deviation(velocity, value, sigma, tuple(j in rows for j in range(m)))


def row_motion(stitched: StitchedRun) -> Section:
    """Return the section that draws how rows deviate from uniform motion: along the belt, across it, in rotation."""
    d = deviation(stitched.findings)
    names = (("along the belt", "µm"), ("across the belt", "µm"), ("yaw", "mrad"))
    width = _NARROW_PX if stitched.head.rows <= _FEW_ROWS else _WIDE_PX
    drawings = [
        (Plot(name, unit, width).draw(d.value[:, k], d.sigma[:, k], d.held), text(f"{name}, {unit}, over rows"))
        for k, (name, unit) in enumerate(names)
    ]
    x, y = d.velocity_mm_s
    lead = (
        f"Position of the board in each row minus that of a belt of constant velocity ({number(x)}, {number(y)}) mm/s, "
        "at the centre of the array, relative to row 0. The band is ±1 σ. Hollow points are rows that only the nominal "
        "motion places."
    )
    columns = ["row", "time s", "along µm", "σ", "across µm", "σ", "yaw mrad", "σ", "placed by", "σ in the image px"]
    listed = folded("figures of every row", table(columns, _rows(stitched, d), 1))
    return Section("motion", "Row motion against the belt", lead, figures(*drawings) + listed)


def _rows(stitched: StitchedRun, d: Deviation) -> Sequence[Sequence[str]]:
    sigma_px = stitched.findings.sigma.rows_px
    times_s = stitched.findings.problem.times_s
    out = []
    for j, (value, sigma) in enumerate(zip(d.value, d.sigma, strict=True)):
        pairs = [number(float(v), n) for k, n in enumerate((1, 1, 4)) for v in (value[k], sigma[k])]
        held = "evidence" if d.held[j] else "nominal motion"
        out.append([str(j), number(float(times_s[j]), 4), *pairs, held, number(sigma_px[j])])
    return out


_SIDE = 300.0
_COLOURS = ("#22456b", "#c0561a", "#18603f", "#7a2a6b", "#6b6b18", "#1a7f8c")


def seams(stitched: StitchedRun) -> Section:
    """Return the section that shows how well the links of each pair of neighbouring cameras agree, over all rows."""
    f, rows = stitched.findings, []
    for i in range(stitched.cameras - 1):
        pairs = [p for p in stitched.pairs if p.links.task.kind == "neighbours" and p.a[0] == i]
        used = sum(p.used for p in pairs)
        # The mean over all rows weighs each pair of frames by its number of links.
        squares = [p.residual_px**2 * p.used for p in pairs if p.residual_px is not None]
        rms = (sum(squares) / used) ** 0.5 if used else None
        strange = f.non_overlapping_pairs.get((i, i + 1))
        note = f"the frames do not overlap in {strange} rows" if strange else "" if used else "no links"
        rows.append(
            [f"{i} – {i + 1}", str(used), str(len(pairs)), number(f.seams_px.get((i, i + 1))), number(rms), note]
        )
    if not rows:
        return Section("seams", "Seams between cameras", "", tag("p", "There is one camera only.", class_="none"))
    lead = (
        "The median residual on the bare board shows whether two cameras are still where they were calibrated; “–” "
        "with fewer than twelve links."
    )
    columns = ["cameras", "links", "pairs of frames", "median residual px", "rms px", ""]
    return Section("seams", "Seams between cameras", lead, table(columns, rows, 1))


def fiducials(stitched: StitchedRun) -> Section:
    """Return the section that compares the detected positions of fiducials with those that the result predicts."""
    listed = stitched.result.quality["fiducials"]
    if not listed:
        why = "The board was not found." if stitched.opened.setup.board_type else "There is no board type."
        return Section("fiducials", "Fiducials", "", tag("p", text(why), class_="none"))
    rows = [
        [
            f["name"],
            str(f["sightings"]),
            *(number(v, 4) for v in f["residual_px"] or (None, None)),
            _length(f["residual_px"]),
        ]
        for f in listed
    ]
    columns = ["fiducial", "detections", "mean x px", "mean y px", "length px"]
    lead = (
        "Residuals of single detections along the tester's axes. Two fiducials determine the position; more check it."
    )
    return Section("fiducials", "Fiducials", lead, figures((_target(stitched), ""), (table(columns, rows, 1), "")))


def _length(residual: list[float] | None) -> str:
    return number(float(np.hypot(residual[0], residual[1])) if residual else None, 4)


def _target(stitched: StitchedRun) -> str:
    """Draw the residuals of all detections as dots around the point of zero residual."""
    f = stitched.findings
    points = f.problem.fiducials
    if points is None or f.plane is None or not (points.which >= 0).any():
        return ""
    mine = points.which >= 0
    off, which, rows = f.adjusted.fiducial_px[mine], points.which[mine], points.row[mine]
    reach = round_up(max(float(np.hypot(*off.T).max()), 0.02))
    scale = (_SIDE / 2 - 16) / reach
    content = []
    for share in (0.5, 1.0):
        r = share * reach * scale
        content.append(tag("circle", cx=_SIDE / 2, cy=_SIDE / 2, r=r, fill="none", stroke="#c9ced3"))
        content.append(label(_SIDE / 2 + 3, _SIDE / 2 - r - 3, f"{share * reach:g} px", class_="faint"))
    content.append(tag("line", x1=0, x2=_SIDE, y1=_SIDE / 2, y2=_SIDE / 2, stroke="#e2e6e9"))
    content.append(tag("line", x1=_SIDE / 2, x2=_SIDE / 2, y1=0, y2=_SIDE, stroke="#e2e6e9"))
    names = [x.name for x in f.plane.board_type.fiducials]
    for (x, y), n, row in zip(off, which, rows, strict=True):
        tooltip = title(f"{names[n]}, row {row}: ({number(float(x))}, {number(float(y))}) px")
        at = {"cx": _SIDE / 2 + float(x) * scale, "cy": _SIDE / 2 + float(y) * scale}
        content.append(tag("circle", tooltip, **at, r=4.0, fill=_COLOURS[n % len(_COLOURS)], fill_opacity=0.75))
    return drawing(_SIDE, _SIDE, *content, label="residuals of fiducials")


_WIDTH_PX = 120


def picture_store(stitched: StitchedRun) -> str:
    """Return all thumbnails as SVG definitions. Sections refer to them, so that the file holds each only once."""
    # There is one definition per frame, because tile graph and frame table show the same picture, and pictures are most
    # of the file.
    images = "".join(
        tag("image", id=picture_id(key), width=t.width, height=t.height, href=t.uri, preserveAspectRatio="none")
        for key, t in stitched.thumbnails.items()
    )
    return tag("svg", tag("defs", images), width=0, height=0, class_="store", aria_hidden="true")


def picture_id(key: FrameKey) -> str:
    """Return the id of a frame's thumbnail, by which the page refers to it."""
    return f"f{key[0]}-{key[1]}"


def frame_table(stitched: StitchedRun) -> Section:
    """Return the section that shows the state of every frame, in a table of rows and cameras."""
    links = links_of(stitched)
    head = tag("tr", tag("th"), *(tag("th", text(f"camera {i}")) for i in range(stitched.cameras)))
    body = "".join(
        tag("tr", tag("th", text(f"row {j}")), *(_cell(stitched, (i, j), links) for i in range(stitched.cameras)))
        for j in range(stitched.head.rows)
    )
    film = tag("div", tag("table", tag("thead", head), tag("tbody", body), class_="film"), class_="scroll tall")
    bad = [[str(c), str(r), verdict, cause] for (c, r), (verdict, cause) in sorted(stitched.causes.items())]
    listed = (
        folded(f"frames that are not ok: {len(bad)}", table(["camera", "row", "state", "cause"], bad)) if bad else ""
    )
    lead = (
        "The number counts links with weight in the adjustment. A dotted line marks a frame without such links; the "
        "other frames of its row place it, or the nominal motion. A dashed line marks a frame that was not delivered."
    )
    return Section("frames", "Frames", lead, film + listed)


def links_of(stitched: StitchedRun) -> Counter[FrameKey]:
    """Count for each frame the links that have a weight above 0 in the adjustment."""
    count: Counter[FrameKey] = Counter()
    for pair in stitched.pairs:
        count[pair.a] += pair.used
        count[pair.b] += pair.used
    return count


def _cell(stitched: StitchedRun, key: FrameKey, links: Counter[FrameKey]) -> str:
    if key in stitched.causes:
        verdict, cause = stitched.causes[key]
        return tag("td", text(verdict), class_="bad", title=cause)
    t = stitched.thumbnails[key]
    width = min(_WIDTH_PX, t.width)
    use = tag("use", href=f"#{picture_id(key)}")
    height = width * t.height / t.width
    shown = tag("svg", use, viewBox=f"0 0 {t.width} {t.height}", width=width, height=height)
    count = text(f"{links[key]}") if links[key] else text("no links")
    return tag("td", shown, count, class_=None if links[key] else "alone", title=f"camera {key[0]}, row {key[1]}")


_TASKS = {
    "rows": "links from row to row",
    "neighbours": "links between cameras",
    "marks": "marks",
    "reference": "links to the reference",
}
_STAGES = {
    "motion": "motion from links",
    "cad": "CAD mapping and the whole adjustment",
    "verdict": "verdict and uncertainty",
}


def timings(stitched: StitchedRun) -> Section:
    """Return the section that lists the wall times of tasks and conclusion, measured on one core for the report."""
    tasks = [[_TASKS.get(k, k), number(ms, 1)] for k, ms in stitched.task_ms.items()]
    stages = [[_STAGES.get(k, k), number(ms, 1)] for k, ms in stitched.result.quality["timings_ms"].items()]
    lead = (
        "Wall time of this stitch, which was made for the report. First the tasks, which a station performs while the "
        "board passes, with reading of frames from disk; then the conclusion after the board has left."
    )
    return Section("timings", "Timings", lead, table(["stage", "ms"], [*tasks, *stages], 1))


def identity(stitched: StitchedRun) -> Section:
    """Return the section of the report that lists software versions and input files."""
    o, q = stitched.opened, stitched.result.quality
    known = o.calibration
    residual = "–" if known.residual_px is None else ", ".join(number(r) for r in known.residual_px) + " px"
    height = "not known" if known.working_distance_mm is None else f"{number(known.working_distance_mm, 1)} mm"
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
        ("… working distance", height),
        ("… residuals", residual),
        ("board type", digest(o.board_path) if o.board_path else "none"),
    ]
    body = tag("div", facts(made), facts(rests_on), class_="columns")
    return Section("identity", "Identity", "Digests are the first 16 digits of SHA-256 of the files.", body)


def digest(path: Path) -> str:
    """Return the name of a file, and the first 16 digits of its SHA-256."""
    return f"{path.name} · {hashlib.sha256(path.read_bytes()).hexdigest()[:16]}"


FORMAT, VERSION = "vaoi-report", 1
_KINDS = ("rows", "neighbours")


def data_block(stitched: StitchedRun) -> str:
    """Return everything except the frames as one JSON object in a script element."""
    # "</script>" inside a text would end the element; an escaped "<" cannot.
    content = json.dumps(document(stitched), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return tag("script", content, type="application/json", id="run")


def document(stitched: StitchedRun) -> dict[str, Any]:
    """Return recording, calibration, board type, result, and all links and detections with their residuals."""
    o = stitched.opened
    return {
        "format": FORMAT,
        "version": VERSION,
        "recording": o.recording.head.model_dump(mode="json", exclude_none=True),
        "calibration": o.calibration.model_dump(mode="json", exclude_none=True),
        "board_type": o.setup.board_type.model_dump(mode="json", exclude_none=True) if o.setup.board_type else None,
        "result": stitch_document(stitched.result),
        "row_motion": _motion(stitched),
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
    frames = np.array([(*t.a, *(t.b or t.a), _KINDS.index(t.kind)) for t in tasks], dtype=np.int32).reshape(-1, 5)
    frames = frames[o.group]
    none2, none1 = np.zeros((0, 2)), np.zeros(0)
    return {
        "a": frames[:, 0:2],
        "b": frames[:, 2:4],
        "between_cameras": frames[:, 4],
        "a_px": np.concatenate([none2, *(e.a_px for e in o.groups)]),
        "b_px": np.concatenate([none2, *(e.b_px for e in o.groups)]),
        "information": np.concatenate([np.zeros((0, 2, 2)), *(e.information for e in o.groups)]),
        "score": np.concatenate([none1, *(e.score for e in o.groups)]),
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


def _motion(stitched: StitchedRun) -> dict[str, Any]:
    d = deviation(stitched.findings)
    return {
        "velocity_mm_s": _short(d.velocity_mm_s),
        "along_um_across_um_yaw_mrad": _short(d.value),
        "sigma": _short(d.sigma),
        "held": list(d.held),
    }


def _short(values: NDArray[Any]) -> Any:
    """Return values as nested lists. Decimals are rounded to six significant digits; integers stay integers."""
    if values.dtype.kind in "iu":
        return values.tolist()
    if values.ndim > 1:
        return [_short(v) for v in values]
    return [float(f"{v:.6g}") for v in values]
