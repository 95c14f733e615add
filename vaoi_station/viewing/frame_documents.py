"""Describe viewed frames as JSON documents and as text."""

from __future__ import annotations

from typing import Any

from vaoi_station.config import StationConfig
from vaoi_station.photometry.image_quality import ImageQuality, histogram
from vaoi_station.viewing.latest_frames import ViewedFrame


def frame_document(frame: ViewedFrame, config: StationConfig) -> dict[str, Any]:
    """Describe one frame as a JSON document: where it comes from, figures of quality, marks in raw px, remarks."""
    inspection, camera = frame.inspection, config.cameras[frame.camera]
    return {
        "camera": frame.camera,
        "name": camera.name,
        "run": frame.run,
        "row": frame.row,
        "number": frame.number,
        "width": camera.width,
        "height": camera.height,
        "exposure_us": camera.exposure_us,
        "figures": _quality_document(inspection.quality),
        "histogram": list(histogram(frame.pixels)),
        "marks": [
            {"x": round(m.x, 3), "y": round(m.y, 3), "score": round(m.score, 3)}
            for m in inspection.marks
            if not m.doubt
        ],
        "doubtful": [{"x": round(m.x, 1), "y": round(m.y, 1), "why": m.doubt} for m in inspection.marks if m.doubt],
        "mark_size_px": None if inspection.size_px is None else round(inspection.size_px, 2),
        "marks_expected": inspection.expected,
        "remarks": list(inspection.remarks),
    }


def row_text(document: dict[str, Any]) -> str:
    """Format the document of one row as text for the terminal."""
    return "\n".join(
        [f"run {document['run']}, row {document['row']} of {document['rows']}", *map(_camera_text, document["cameras"])]
    )


def _camera_text(document: dict[str, Any]) -> str:
    if "missing" in document:
        return f"camera {document['camera']} ({document['name']}): no frame: {document['missing']}"
    f = document["figures"]
    blur = "no edges" if f["blur_px"] is None else f"blur {f['blur_px']:.2f} px (MTF50 {f['mtf50']:.2f} cycles/px)"
    marks = "" if document["mark_size_px"] is None else f", {len(document['marks'])} marks"
    line = (
        f"camera {document['camera']} ({document['name']}): focus {f['focus']:.4g}, {blur}, mean {f['mean']:.0%}, "
        f"1 % below {f['low']:.0%}, 99 % below {f['high']:.0%}, saturated {f['saturated']:.2%}{marks}"
    )
    return "\n".join([line, *(f"  - {r}" for r in document["remarks"])])


def _quality_document(f: ImageQuality) -> dict[str, Any]:
    return {
        "focus": float(f"{f.focus:.5g}"),
        "blur_px": _rounded(f.blur_px),
        "mtf50": _rounded(f.mtf50),
        "blur_tiles_px": [[_rounded(b) for b in row] for row in f.blur_tiles_px],
        "mean": _rounded(f.mean),
        "low": _rounded(f.low),
        "high": _rounded(f.high),
        "saturated": round(f.saturated, 6),
    }


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
