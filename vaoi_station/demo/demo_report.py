"""The report of `vaoi demo --once`: a JSON document and a text."""

from __future__ import annotations

from pydantic import Field

from vaoi_station.demo.truth_comparison import Deviation
from vaoi_station.model import Reason, Status, Strict
from vaoi_station.runs.states.schemas import VerdictCounts

LIMIT_PX = 1.0
"""Largest distance between result and truth, in px, for which the verdict ok counts as correct."""


class LinkCount(Strict):
    """Number of links found, and of links that have weight in the adjustment."""

    found: int
    used: int


class Residuals(Strict):
    """Residuals of links and fiducials after the adjustment."""

    links: dict[str, LinkCount]
    """Number of links by kind: between rows, and between neighbouring cameras."""
    link_median_px: float | None
    link_scatter_px: float | None
    fiducials_px: dict[str, float | None]
    """Distance of each fiducial from its predicted position; None if it was not found."""


class Belt(Strict):
    """Speeds of the board: the nominal one, the one measured by stitching, and the true one."""

    nominal_mm_s: float
    measured_mm_s: float | None
    true_mm_s: float


class DemoTimings(Strict):
    """Times of the run and of the demo."""

    filming_s: float | None
    ready_after_last_frame_ms: float | None
    """Time from the arrival of the last frame until the matrices are finished."""
    links: int
    links_while_filming: int
    links_ms: float
    """Sum of the times that the workers spent on finding links."""
    conclude_ms: float
    stages_ms: dict[str, float]
    """Times of the parts of the conclusion: motion, CAD mapping, verdict."""
    pictures_s: float
    """Time to render all component images, fetch them by HTTP and write them."""
    total_s: float


class DemoReport(Strict):
    """The document of `vaoi demo --once --json`."""

    format: str = "vaoi-demo"
    version: int = 1
    ok: bool
    scenario: str
    board_type: str
    run: str
    status: Status
    reasons: tuple[Reason, ...]
    cameras: int
    rows: int
    frames: VerdictCounts
    residuals: Residuals
    belt: Belt
    sigma_px: float | None = Field(description="Predicted standard deviation of the worst view of a component.")
    deviation: Deviation
    timings: DemoTimings
    components: int
    pictures: int
    out: str
    contact_sheet: str


def as_text(report: DemoReport) -> str:
    """Format the report of the demo as text."""
    lines = [f"board 1 of scenario {report.scenario!r}, run {report.run}: {report.status.upper()}"]
    lines += [f"  {name:<10s}{text}" for name, text in _entries(report)]
    lines += [f"  - {reason.message}" for reason in report.reasons]
    if report.status is Status.OK and not report.ok:
        lines.append(
            f"  - The verdict is ok, but a position is more than {LIMIT_PX:g} px from the truth, or is missing."
        )
    return "\n".join(lines)


def headline(report: DemoReport) -> tuple[str, ...]:
    """Return the contact sheet's text lines: frame count, belt speed, time to the matrices, position error."""
    d, t = report.deviation, report.timings
    return (
        f"{report.cameras} cameras × {report.rows} rows, {report.frames.ok} frames ok",
        f"belt {_number(report.belt.measured_mm_s, 2)} mm/s (nominal {report.belt.nominal_mm_s:.0f})",
        f"matrices {_number(t.ready_after_last_frame_ms, 0)} ms after the last frame",
        f"error {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most, over {d.views} views",
    )


def _entries(report: DemoReport) -> list[tuple[str, str]]:
    f, r, b, d, t = report.frames, report.residuals, report.belt, report.deviation, report.timings
    size = f"{report.rows} rows × {report.cameras} cameras"
    links = ", ".join(f"{kind} {count.used} of {count.found}" for kind, count in r.links.items())
    seen = [off for off in r.fiducials_px.values() if off is not None]
    stages = ", ".join(f"{name} {ms:.0f}" for name, ms in t.stages_ms.items())
    return [
        ("frames", f"{size}: {f.ok} ok, {f.incomplete} incomplete, {f.missing} missing"),
        ("links", f"{links} used; residual {_number(r.link_median_px, 3)} px median"),
        ("fiducials", f"{len(seen)} of {len(r.fiducials_px)}, residual at most {max(seen, default=0):.3f} px"),
        ("belt", f"{_number(b.measured_mm_s, 3)} mm/s measured, {b.nominal_mm_s:.3f} nominal, {b.true_mm_s:.3f} true"),
        ("positions", f"error {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most ({d.rms_mm * 1e3:.2f} and "
                   f"{d.max_mm * 1e3:.2f} µm) over {d.views} views; predicted σ {_number(report.sigma_px, 3)} px"),
        ("matrices", f"{_number(t.ready_after_last_frame_ms, 0)} ms after the last frame ({t.links_while_filming} of "
                     f"{t.links} tasks while filming; conclusion {t.conclude_ms:.0f} ms: {stages})"),
        ("images", f"{report.pictures} images of {report.components} components in {t.pictures_s:.1f} s "
                   f"→ {report.out}"),
        ("sheet", report.contact_sheet),
        ("total", f"{t.total_s:.1f} s"),
    ]  # fmt: skip


def _number(value: float | None, digits: int) -> str:
    return "?" if value is None else f"{value:.{digits}f}"
