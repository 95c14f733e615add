"""The report of `vaoi demo --once`: one run, as the service states it, compared with the twin's truth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from vaoi_station.model import Strict
from vaoi_station.simulation import Passage

LIMIT_PX = 1.0
"""Largest distance between result and truth, in px, for which the verdict ok counts as correct."""

View = Sequence[float]
"""The centre of a footprint in one frame: camera, row, and x and y in raw pixels."""


class Deviation(Strict):
    """Distances between the positions of result and truth over all views of all components, in px and in board mm."""

    views: int
    """Number of views of the truth that the result places."""
    unplaced: int
    """Number of views of the truth that the result does not place."""
    rms_px: float
    max_px: float
    rms_mm: float
    max_mm: float
    worst: str | None
    """Component, camera and row of the view with the largest distance."""

    @property
    def within_limit(self) -> bool:
        """Whether the result is as close to the truth as it must be with the verdict ok."""
        return self.unplaced == 0 and self.max_px <= LIMIT_PX


class DemoReport(Strict):
    """The document of `vaoi demo --once --json`."""

    format: str = "vaoi-demo"
    version: int = 2
    ok: bool
    scenario: str
    run: dict[str, Any]
    """The run, as `GET runs/{id}` states it, without its list of frames."""
    quality: dict[str, Any]
    """Figures on which the verdict is based, as the result states them; {} if there is no result."""
    true_mm_s: float
    """The true speed of the board."""
    deviation: Deviation
    components: int
    pictures: int
    pictures_s: float
    """Time to render all component images, fetch them by HTTP and write them."""
    total_s: float
    out: str
    contact_sheet: str


def evaluate(
    scenario: str, run: dict[str, Any], matrices: dict[str, Any], passage: Passage, **output: Any
) -> DemoReport:
    """Compare a run with the truth of its board. `output` are the last six fields of the report.

    Args:
        scenario: name of the twin's scenario.
        run: document of the run.
        matrices: document of its result, {} if it has none: then every view of the truth counts as unplaced.
        passage: the board that passed.
        output: the fields of the report that tell what was written.
    """
    resolutions = [camera.px_per_mm for camera in passage.twin.cameras]
    deviation = compare_with_truth(passage.truth()["views"], matrices.get("components") or {}, resolutions)
    return DemoReport(
        ok=run["verdict"] == "ok" and deviation.within_limit,
        scenario=scenario,
        run={key: value for key, value in run.items() if key != "frames"},
        quality=matrices.get("quality", {}),
        true_mm_s=round(true_speed_mm_s(passage), 4),
        deviation=deviation,
        **output,
    )


def compare_with_truth(
    truth: Mapping[str, Iterable[View]], result: Mapping[str, Iterable[View]], px_per_mm: Sequence[float]
) -> Deviation:
    """Compare the component positions of a result with the true ones, in raw pixels.

    Args:
        truth: true views of every component, by the component's address.
        result: views of the result, by address; views that the truth does not have are ignored.
        px_per_mm: resolution of each camera.
    """
    errors: list[tuple[float, float, str]] = []
    unplaced = 0
    for address, views in truth.items():
        places = {(int(camera), int(row)): (x, y) for camera, row, x, y in result.get(address, ())}
        for camera, row, x, y in views:
            place = places.get((int(camera), int(row)))
            if place is None:
                unplaced += 1
                continue
            off_px = math.hypot(place[0] - x, place[1] - y)
            errors.append((off_px, off_px / px_per_mm[int(camera)], f"{address}, camera {camera:.0f}, row {row:.0f}"))
    px, mm = (np.array([e[k] for e in errors] or [0.0]) for k in (0, 1))
    return Deviation(
        views=len(errors),
        unplaced=unplaced,
        rms_px=round(float(np.sqrt(np.mean(px**2))), 5),
        max_px=round(float(px.max()), 5),
        rms_mm=round(float(np.sqrt(np.mean(mm**2))), 5),
        max_mm=round(float(mm.max()), 5),
        worst=max(errors)[2] if errors else None,
    )


def true_speed_mm_s(passage: Passage) -> float:
    """Return the true speed of the board's centre, from the least-squares line through its positions at the pulses."""
    board = passage.twin.scenario.board
    middle = np.array([board.width_mm / 2, board.length_mm / 2, 1.0])
    places_mm = np.array([(passage.pose(t) @ middle)[:2] for t in passage.pulse_times_s])
    times_s = np.array(passage.pulse_times_s)
    centred_s = times_s - times_s.mean()
    return float(np.hypot(*(centred_s @ places_mm / (centred_s @ centred_s))))


def as_text(report: DemoReport) -> str:
    """Format the report of the demo as text."""
    run, quality, d, timings = report.run, report.quality, report.deviation, report.run.get("timings") or {}
    counts, residual = run["counts"], quality.get("residual_px", {})
    links = ", ".join(f"{kind} {n['used']} of {n['found']}" for kind, n in quality.get("links", {}).items())
    fiducials = [fiducial["residual_px"] for fiducial in quality.get("fiducials", ())]
    seen_px = [math.hypot(*off) for off in fiducials if off is not None]
    stages = ", ".join(f"{name} {ms:.0f}" for name, ms in quality.get("timings_ms", {}).items())
    entries = {
        "frames": f"{run['rows']} rows × {run['cameras']} cameras: {counts['ok']} ok, "
        f"{counts['incomplete']} incomplete, {counts['missing']} missing",
        "links": f"{links} used; residual {_number(residual.get('median'), 3)} px median",
        "fiducials": f"{len(seen_px)} of {len(fiducials)}, residual at most {max(seen_px, default=0):.3f} px",
        "belt": f"{_number(_measured_mm_s(run), 3)} mm/s measured, {report.true_mm_s:.3f} true",
        "positions": f"error {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most ({d.rms_mm * 1e3:.2f} and "
        f"{d.max_mm * 1e3:.2f} µm) over {d.views} views; predicted σ {_number(quality.get('cad_sigma_px'), 3)} px",
        "matrices": f"{_number(timings.get('ready_after_last_frame_ms'), 0)} ms after the last frame "
        f"({timings.get('links_while_filming', 0)} of {timings.get('links', 0)} tasks while filming; "
        f"conclusion {timings.get('conclude_ms', 0):.0f} ms: {stages})",
        "images": f"{report.pictures} images of {report.components} components in {report.pictures_s:.1f} s "
        f"→ {report.out}",
        "sheet": report.contact_sheet,
        "total": f"{report.total_s:.1f} s",
    }
    lines = [f"board 1 of scenario {report.scenario!r}, run {run['id']}: {run['verdict'].upper()}"]
    lines += [f"  {name:<10s}{text}" for name, text in entries.items()]
    lines += [f"  - {reason['message']}" for reason in run["reasons"]]
    if run["verdict"] == "ok" and not report.ok:
        lines.append(f"  - The verdict is ok, but a position is missing, or more than {LIMIT_PX:g} px from the truth.")
    return "\n".join(lines)


def headline(report: DemoReport) -> tuple[str, ...]:
    """Return the contact sheet's text lines: frame count, belt speed, time to the matrices, position error."""
    run, d = report.run, report.deviation
    ready_ms = (run.get("timings") or {}).get("ready_after_last_frame_ms")
    return (
        f"{run['cameras']} cameras × {run['rows']} rows, {run['counts']['ok']} frames ok",
        f"belt {_number(_measured_mm_s(run), 2)} mm/s (true {report.true_mm_s:.2f})",
        f"matrices {_number(ready_ms, 0)} ms after the last frame",
        f"error {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most, over {d.views} views",
    )


def _measured_mm_s(run: dict[str, Any]) -> float | None:
    belt = run.get("belt")
    return math.hypot(*belt["measured_mm_s"]) if belt else None


def _number(value: float | None, digits: int) -> str:
    return "?" if value is None else f"{value:.{digits}f}"
