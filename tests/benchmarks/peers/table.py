"""Score the runs and update the table: `python -m peers.table STRIPS RUNS`.

Only stitchers with new runs are scored; `results.json` keeps its entries of the others. The table in the documentation
is written between two markers, from `results.json` alone.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from .scoring import score
from .strip import STRIPS, Strip, translations

HERE = Path(__file__).parent
RESULTS = HERE / "results.json"
PAGE = HERE.parents[2] / "docs" / "measured.md"
MARKERS = ("<!-- table -->", "<!-- end of table -->")
TITLES = {
    "ours": "this station",
    "stitching": "`stitching`",
    "ashlar": "ASHLAR",
    "multiview_stitcher": "multiview-stitcher",
    "m2stitch": "m2stitch",
    "nominal": "nothing: nominal places",
}

Run = dict[str, Any]


def scored(lines: Iterable[str], strips: Path) -> list[Run]:
    """Read runs of `place`, one per line, and replace their matrices by their scores."""
    return [_scored(json.loads(line), strips) for line in lines]


def nominal(strips: Path) -> list[Run]:
    """Score the nominal positions: the result of no stitching at all."""
    runs = []
    for name in STRIPS:
        matrices = [m.tolist() for m in translations(Strip.read(strips / name).nominal_px) if m is not None]
        runs.append(_scored({"name": "nominal", "strip": name, "setting": "", "matrices": matrices}, strips))
    return runs


def _scored(run: Run, strips: Path) -> Run:
    if "failure" in run:
        return run
    height, width = np.load(strips / run["strip"] / "frames.npy", mmap_mode="r").shape[1:]
    placed = [None if m is None else np.array(m, np.float64) for m in run["matrices"]]
    errors = score(placed, np.load(strips / run["strip"] / "truth.npy"), (width, height))
    kept = {key: value for key, value in run.items() if key != "matrices"}
    return kept | {key: round(v, 4) if isinstance(v, float) else v for key, v in (kept | asdict(errors)).items()}


def updated(before: list[Run], new: list[Run]) -> list[Run]:
    """Return the earlier results, with those of stitchers that were run again replaced."""
    names = {run["name"] for run in new}
    return [run for run in before if run["name"] not in names] + new


def page_part(runs: list[Run]) -> str:
    """Return the best setting of each stitcher on each strip, as a table in Markdown."""
    lines = ["| | " + " | ".join(f"{s}: px | CPU s" for s in STRIPS) + " |", "|---|" + "--:|--:|" * len(STRIPS)]
    for name, title in TITLES.items():
        cells = []
        for strip in STRIPS:
            best = _best(runs, name, strip)
            cells += [_px(best), _seconds(best)] if best else [_no_result(runs, name, strip), "–"]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _no_result(runs: list[Run], name: str, strip: str) -> str:
    return "failed" if any((r["name"], r["strip"]) == (name, strip) for r in runs) else "not run"


def _best(runs: list[Run], name: str, strip: str) -> Run | None:
    """Return the setting with the smallest error, among equals the fastest; None if none placed all frames."""
    own = [r for r in runs if (r["name"], r["strip"]) == (name, strip) and r.get("as_it_is", True)]
    return min((r for r in own if _placed(r, runs)), key=lambda r: (r["rms_px"], r.get("cpu_s", 0)), default=None)


def _placed(run: Run, runs: list[Run]) -> bool:
    """Return whether a run counts as a result: all frames are placed, and better than by the prior."""
    if "failure" in run or run["dropped"]:
        return False
    # A stitcher whose result is worse than its prior has not found the right matches.
    prior = next((r for r in runs if (r["name"], r["strip"]) == ("nominal", run["strip"])), None)
    return prior is None or run["rms_px"] <= prior["rms_px"]


def _px(run: Run) -> str:
    rms = run["rms_px"]
    return f"{rms:.4f}" if rms < 0.01 else f"{rms:.3f}" if rms < 1 else f"{rms:.2f}"


def _seconds(run: Run) -> str:
    return "–" if "cpu_s" not in run else f"{run['cpu_s']:.2f}" if run["cpu_s"] < 10 else f"{run['cpu_s']:.0f}"


def write_page(page: Path, part: str) -> None:
    """Write the table between the markers of a page."""
    before, found, rest = page.read_text().partition(MARKERS[0])
    _, ended, after = rest.partition(MARKERS[1])
    if not (found and ended):
        raise ValueError(f"{page.name} has no {MARKERS[0]} … {MARKERS[1]}")
    page.write_text(f"{before}{MARKERS[0]}\n{part}\n{MARKERS[1]}{after}")


def main() -> None:
    """Score the runs of a directory, and update `results.json` and the page."""
    strips, runs = Path(sys.argv[1]), Path(sys.argv[2])
    new = nominal(strips)
    for path in sorted(runs.glob("*.jsonl")):
        new += scored(path.read_text().splitlines(), strips)
    before = json.loads(RESULTS.read_text()) if RESULTS.is_file() else []
    results = updated(before, new)
    RESULTS.write_text("[\n" + ",\n".join(json.dumps(run) for run in results) + "\n]\n")
    write_page(PAGE, page_part(results))


if __name__ == "__main__":
    main()
