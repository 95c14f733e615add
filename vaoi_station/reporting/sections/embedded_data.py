"""The numbers behind the drawings: as JSON inside the report, and as numpy arrays in the bundle."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.results import stitch_document
from vaoi_station.reporting.drawing.svg import tag
from vaoi_station.reporting.sections.row_motion import deviation
from vaoi_station.reporting.stitched_run import StitchedRun
from vaoi_station.stitching.matching.evidence import Detections

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
