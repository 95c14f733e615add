"""What `vaoi demo --once` tells: one document for programs, a page of text for people."""

from __future__ import annotations

from pydantic import Field

from vaoi_station.demo.truth_comparison import Deviation
from vaoi_station.model import Status, Strict
from vaoi_station.runs.states.schemas import Reason, VerdictCounts

LIMIT_PX = 1.0
"""A result that says ok and errs by more contradicts itself."""


class LinkCount(Strict):
    """Points found in two frames, and those the adjustment believes."""

    found: int
    used: int


class Residuals(Strict):
    """What is left of the links' and the fiducials' misfits after the adjustment."""

    links: dict[str, LinkCount]
    """Between rows and between neighbouring cameras."""
    link_median_px: float | None
    link_scatter_px: float | None
    fiducials_px: dict[str, float | None]
    """Distance of each fiducial from its place; None where it was not found."""


class Belt(Strict):
    """Speed of the board."""

    nominal_mm_s: float
    measured_mm_s: float | None
    true_mm_s: float


class DemoTimings(Strict):
    """Where the time went."""

    filming_s: float | None
    ready_after_last_frame_ms: float | None
    """From the arrival of the last frame to finished matrices."""
    links: int
    links_while_filming: int
    links_ms: float
    """Workers' time on links, summed."""
    conclude_ms: float
    stages_ms: dict[str, float]
    """Of the conclusion: motion, CAD mapping, verdict."""
    pictures_s: float
    """All component pictures rendered, fetched over HTTP and written."""
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
    """The report for people."""
    lines = [f"board 1 of scenario {report.scenario!r}, run {report.run}: {report.status.upper()}"]
    lines += [f"  {name:<10s}{text}" for name, text in _entries(report)]
    lines += [f"  - {reason.message}" for reason in report.reasons]
    if report.status is Status.OK and not report.ok:
        lines.append("  - The verdict is ok, but the truth is further away than an ok result may be.")
    return "\n".join(lines)


def headline(report: DemoReport) -> tuple[str, ...]:
    """The figures of a contact sheet."""
    d, t = report.deviation, report.timings
    return (
        f"{report.cameras} cameras × {report.rows} rows, {report.frames.ok} frames ok",
        f"belt {_number(report.belt.measured_mm_s, 2)} mm/s (nominal {report.belt.nominal_mm_s:.0f})",
        f"matrices {_number(t.ready_after_last_frame_ms, 0)} ms after the last frame",
        f"off the truth by {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most, over {d.views} views",
    )


def _entries(report: DemoReport) -> list[tuple[str, str]]:
    f, r, b, d, t = report.frames, report.residuals, report.belt, report.deviation, report.timings
    film = f"{report.rows} rows × {report.cameras} cameras"
    links = ", ".join(f"{kind} {count.used} of {count.found}" for kind, count in r.links.items())
    seen = [off for off in r.fiducials_px.values() if off is not None]
    stages = ", ".join(f"{name} {ms:.0f}" for name, ms in t.stages_ms.items())
    return [
        ("frames", f"{film}: {f.ok} ok, {f.incomplete} incomplete, {f.missing} missing"),
        ("links", f"{links} points used; misfit {_number(r.link_median_px, 3)} px median"),
        ("fiducials", f"{len(seen)} of {len(r.fiducials_px)}, at most {max(seen, default=0):.3f} px from their places"),
        ("belt", f"{_number(b.measured_mm_s, 3)} mm/s measured, {b.nominal_mm_s:.3f} nominal, {b.true_mm_s:.3f} true"),
        ("places", f"off the truth by {d.rms_px:.3f} px rms, {d.max_px:.3f} px at most ({d.rms_mm * 1e3:.2f} and "
                   f"{d.max_mm * 1e3:.2f} µm) over {d.views} views; predicted σ {_number(report.sigma_px, 3)} px"),
        ("matrices", f"{_number(t.ready_after_last_frame_ms, 0)} ms after the last frame ({t.links_while_filming} of "
                     f"{t.links} tasks while filming; conclusion {t.conclude_ms:.0f} ms: {stages})"),
        ("pictures", f"{report.pictures} of {report.components} components in {t.pictures_s:.1f} s → {report.out}"),
        ("sheet", report.contact_sheet),
        ("took", f"{t.total_s:.1f} s"),
    ]  # fmt: skip


def _number(value: float | None, digits: int) -> str:
    return "?" if value is None else f"{value:.{digits}f}"
