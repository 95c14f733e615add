"""The head of the report: verdict, reasons, and the key numbers."""

from __future__ import annotations

from typing import Any

from vaoi_station.reporting.drawing.html_page import Section, facts
from vaoi_station.reporting.drawing.scales import number
from vaoi_station.reporting.drawing.svg import tag, text
from vaoi_station.reporting.stitched_run import StitchedRun


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
