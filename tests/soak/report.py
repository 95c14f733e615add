"""The report of soaks: docs/measured/soak.json, soak.svg, and the tables of docs/measured.md."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.soak.series import Series, all_series
from tests.soak.slopes import LEAST_BLOCKS, Slope, block_medians
from vaoi_station.reporting.drawing import drawing, label, polyline, tag

DOCS = Path(__file__).resolve().parents[2] / "docs" / "measured"
TITLES = {"quiet": "Without faults", "faults": "With faults"}
_WIDTH, _HEIGHT, _GAP_X, _GAP_Y, _TOP = 330.0, 90.0, 40.0, 44.0, 40.0
_AXIS, _INK, _COLOURS = "#bbbbbb", "#222222", {"quiet": "#0b6e4f", "faults": "#b0522d"}
_DRAWN = re.compile(r"(.*: (resident memory|descriptors|threads)|database|shared memory, |last frame).*")
_BLOCK = re.compile(r"(<!-- soak: (\w+) -->\n)(.*?)(\n<!-- end -->)", re.DOTALL)


def write_report(raw: Mapping[str, Path], docs: Path = DOCS) -> None:
    """Write JSON and plot of soaks, by name, and renew the tables of measured.md beside them."""
    soaks = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in raw.items()}
    series = {name: all_series(soak["samples"]) for name, soak in soaks.items()}
    document = {
        name: {
            **{key: soak[key] for key in ("plan", "accounts", "ends", "injected", "seconds")},
            "boards": len(soak["samples"]),
            "series": [s.document() for s in series[name]],
        }
        for name, soak in soaks.items()
    }
    (docs / "soak.json").write_text(json.dumps(document, separators=(",", ":")) + "\n", encoding="utf-8")
    (docs / "soak.svg").write_text(plot(series), encoding="utf-8")
    page = docs.parent / "measured.md"
    # Faults end most lives before a slope can be seen.
    blocks = {
        name: summary(soak) + "\n\n" + (fault_table(soak) if soak["injected"] else slope_table(series[name]))
        for name, soak in soaks.items()
    }
    text = _BLOCK.sub(lambda m: m[1] + blocks.get(m[2], m[3]) + m[4], page.read_text(encoding="utf-8"))
    page.write_text(text, encoding="utf-8")


def summary(soak: Mapping[str, Any]) -> str:
    """Return what has become of the boards of a soak, as a table."""
    accounts, ends = soak["accounts"], soak["ends"]
    verdicts = ", ".join(f"{n} {v}" for v, n in sorted(accounts["verdicts"].items()))
    latencies = [s["result_ms"] for s in soak["samples"] if s["result_ms"] is not None]
    quantiles = ", ".join(f"{np.percentile(latencies, q):.0f}" for q in (50, 95, 99))
    rows = [
        ("runs announced", f"{accounts['announced']} ({verdicts}) in {soak['seconds'] / 60:.0f} min"),
        ("boards missed, each with an event", str(accounts["missed"])),
        ("runs that are not accounted for", str(len(accounts["finds"]))),
        ("last frame to result, ms: median, 95 %, 99 %", quantiles),
        ("ends of the station: by a fault of the soak, by itself", f"{ends['wanted']}, {len(ends['own'])}"),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {a} | {b} |" for a, b in rows)])


def slope_table(series: Sequence[Series]) -> str:
    """Return the slopes that differ from zero with their intervals, and the number of the others, as a table."""
    lines = ["| growth | median | slope per 1000 boards |", "|---|--:|---|"]
    moving = [s for s in series if s.slope is not None and not s.slope.flat]
    rows = (f"| {s.name} | {_cells(s.slope)} |" for s in moving if s.slope is not None)
    short = sum(s.slope is None for s in series)
    others = [f"| {len(series) - len(moving) - short} other series | | indistinguishable from zero |"]
    others += [f"| {short} series | | lives too short |"] if short else []
    return "\n".join([*lines, *rows, *others])


def fault_table(soak: Mapping[str, Any]) -> str:
    """Return the faults by kind, and how long the next board took after each, as a table."""
    kinds: dict[str, list[float]] = {}
    for fault in soak["injected"]:
        kinds.setdefault(fault["name"], []).append(fault["recovered_s"])
    lines = ["| fault | number | from its end to the next result, s: median, largest |", "|---|---|---|"]
    rows = (f"| {k} | {len(v)} | {np.median(v):.1f}, {max(v):.1f} |" for k, v in sorted(kinds.items()))
    return "\n".join([*lines, *rows])


def plot(series: Mapping[str, Sequence[Series]]) -> str:
    """Return all drawn series as panels of one SVG, a column for each soak."""
    names = [s.name for s in next(iter(series.values())) if _DRAWN.fullmatch(s.name)]
    width = len(series) * (_WIDTH + _GAP_X) + _GAP_X
    height = _TOP + len(names) * (_HEIGHT + _GAP_Y)
    parts = [tag("rect", x=0.0, y=0.0, width=width, height=height, fill="#ffffff")]
    for column, (soak, found) in enumerate(series.items()):
        left = _GAP_X + column * (_WIDTH + _GAP_X)
        parts.append(label(left, 18, TITLES.get(soak, soak), font_size=14, fill=_INK))
        by_name = {s.name: s for s in found}
        for row, name in enumerate(names):
            parts += _panel(by_name[name], left, _TOP + row * (_HEIGHT + _GAP_Y), _COLOURS.get(soak, _INK))
    return drawing(width, height, *parts, label="Use of memory and files over the boards of a soak").replace(
        "<svg", '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"', 1
    )


def _panel(series: Series, left: float, top: float, colour: str) -> list[str]:
    lives = [block_medians(x, y) for x, y in series.lives if len(x) >= LEAST_BLOCKS]
    frame = tag("rect", x=left, y=top, width=_WIDTH, height=_HEIGHT, fill="none", stroke=_AXIS)
    out = [frame, label(left, top - 5, series.name, font_size=11, fill=_INK)]
    if not lives:
        return out
    last = max(float(x[-1]) for x, _ in lives)
    high = 1.1 * max(float(y.max()) for _, y in lives) or 1.0
    for x, y in lives:
        at = zip(left + x / last * _WIDTH, top + _HEIGHT * (1 - y / high), strict=True)
        out.append(polyline(at, stroke=colour, stroke_width=1.2))
    out.append(label(left - 3, top + 9, f"{high:.3g}", font_size=9, text_anchor="end", fill=_INK))
    out.append(
        label(left + _WIDTH, top + _HEIGHT + 11, f"{last:.0f} boards", font_size=9, text_anchor="end", fill=_INK)
    )
    return out


def _cells(slope: Slope) -> str:
    low, middle, high = (1000 * v for v in (slope.low, slope.per_board, slope.high))
    return f"{slope.median:.4g} | {middle:+.2g} ({low:+.2g} … {high:+.2g})"
