"""Heights of packages on boards of the twin, from pixels and from links.

`python -m tests.heights.twin_heights SCENARIO FIRST:END` prints two tables for docs/measured: `vaoi heights` and
`heights_mm` of the result. Parts count as in `tests.cases.heights`: at least 0.5 mm in two frames or more; measured
means a standard deviation of at most 0.15 mm.
"""

from __future__ import annotations

import sys
from collections import defaultdict

import numpy as np

from tests.cases.heights import errors, row
from vaoi_station.heights.estimates import heights_document, measure_heights
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.work import StitchSetup, stitch_frames

Measured = dict[str, list[tuple[int, np.ndarray]]]
"""For each package and each board: the number of tall parts, and error and sigma (k, 2) of the measured ones, mm."""
KINDS = ("pixels", "links")
HEAD = "| package | measured | median error, mm | 90 %, mm | error/σ, rms | beyond 3 σ |\n|---|---|---|---|---|---|"


def measure(twin: Twin, board: int) -> tuple[dict[str, tuple[int, np.ndarray]], ...]:
    """Return the heights of one board by package, for each of `KINDS`."""
    passage = twin.passage(board)
    head, truth, frames = passage.head(), passage.truth(), passage.render_all()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    result = stitch_frames(setup, head, lambda i, j: frames.get((i, j)))
    pixels = measure_heights(twin.board_type, result, cameras, lambda i, j: frames.get((i, j)))
    sigma_mm = result.quality["height_sigma_mm"]
    links = {ref: {"height_mm": mm, "sigma_mm": sigma_mm[ref]} for ref, mm in result.quality["heights_mm"].items()}
    package = {part.ref: part.package.name for part in twin.parts}

    def of(found: dict[str, dict[str, float]], name: str) -> tuple[int, np.ndarray]:
        heights = {ref: mm for ref, mm in truth["heights"].items() if package[ref] == name}
        return errors(found, {**truth, "heights": heights})

    names = sorted(set(package.values()))
    return tuple(
        {name: of(found, name) for name in names} for found in (heights_document(pixels, twin.board_type), links)
    )


def main() -> None:
    """Print the tables of some boards of a scenario."""
    scenario, boards = sys.argv[1:]
    first, end = map(int, boards.split(":"))
    twin = Twin(read_scenario(scenario_path(scenario)))
    found: tuple[Measured, ...] = tuple(defaultdict(list) for _ in KINDS)
    for board in range(first, end):
        for whole, of_board in zip(found, measure(twin, board), strict=True):
            for name, counted in of_board.items():
                whole[name].append(counted)
    for kind, whole in zip(KINDS, found, strict=True):
        print(f"\n{kind}:\n\n{HEAD}")
        rows = {name: (sum(n for n, _ in each), np.concatenate([p for _, p in each])) for name, each in whole.items()}
        rows["all"] = sum(n for n, _ in rows.values()), np.concatenate([p for _, p in rows.values()])
        for name, (tall, pairs) in rows.items():
            if tall:
                print(row(name, tall, pairs))


if __name__ == "__main__":
    main()
