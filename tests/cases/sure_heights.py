"""How often a sure statement about a height is wrong, on boards of the twin.

`python -m tests.cases.sure_heights SCENARIO FIRST:END` prints counts for docs/measured: parts, statements with a
probability of at least 0.995 and how many of them are wrong, "lower" and "higher" where the part is as in the CAD data
and where it is not (faults `absent_parts`), and intervals that do not contain the height.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any

from vaoi_station.heights.estimates import TOLERANCE_MM, TOLERANCE_SHARE, heights_document, measure_heights
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.work import StitchSetup, stitch_frames

_SURE, _STEP_MM = 0.995, 0.02


def right_statement(true_mm: float, expected_mm: float) -> str:
    """Return what a comparison should say."""
    tolerance = max(TOLERANCE_MM, TOLERANCE_SHARE * expected_mm)
    off = true_mm - expected_mm
    return "lower" if off < -tolerance else "higher" if off > tolerance else "agrees"


def count(entry: dict[str, Any], true_mm: float) -> Counter[str]:
    """Return the counts of one part."""
    right, said = right_statement(true_mm, entry["expected_mm"]), entry["comparison"]
    out = Counter(["parts", said, "as expected" if right == "agrees" else "other than expected"])
    if said in ("agrees", "lower", "higher") and entry["probability"] >= _SURE:
        out.update(["sure"] + ["sure and wrong"] * (said != right))
    if said in ("lower", "higher"):
        out["said to be other than expected, rightly" if said == right else "said so, wrongly"] += 1
    if entry["height_mm"] is not None:
        out["with a number"] += 1
    elif entry["low_mm"] is not None:
        ranges = [(i["low_mm"], i["high_mm"]) for i in entry.get("intervals", [entry])]
        out["with intervals"] += 1
        out["with intervals beside the height"] += not any(a - _STEP_MM <= true_mm <= b + _STEP_MM for a, b in ranges)
    return out


def measure(twin: Twin, board: int) -> Counter[str]:
    """Return the counts of one board."""
    passage = twin.passage(board)
    head, truth, frames = passage.head(), passage.truth(), passage.render_all()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    result = stitch_frames(setup, head, lambda i, j: frames.get((i, j)))
    found = measure_heights(twin.board_type, result, cameras, lambda i, j: frames.get((i, j)))
    document = heights_document(found, twin.board_type)
    return sum((count(entry, truth["heights"][ref]) for ref, entry in document.items()), Counter())


def print_counts(total: Counter[str]) -> None:
    """Print counts, one a line."""
    for name, number in sorted(total.items()):
        print(f"{number:7d} {name}")


def main() -> None:
    """Print the counts of some boards of a scenario."""
    scenario, boards = sys.argv[1:]
    first, end = map(int, boards.split(":"))
    twin = Twin(read_scenario(Path(scenario) if Path(scenario).is_file() else scenario_path(scenario)))
    total: Counter[str] = Counter()
    for board in range(first, end):
        total += measure(twin, board)
    print_counts(total)


if __name__ == "__main__":
    main()
