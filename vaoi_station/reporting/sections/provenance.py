"""The sections on times, software, and the input files with their digests."""

from __future__ import annotations

import hashlib
import platform
from pathlib import Path

import numpy as np

from vaoi_station.reporting.drawing.html_page import Section, facts, table
from vaoi_station.reporting.drawing.scales import number
from vaoi_station.reporting.drawing.svg import tag
from vaoi_station.reporting.stitched_run import StitchedRun

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
