"""Boards of the twin with rows and arrays of equal parts, at whose periods several heights explain the pictures.

`python -m tests.cases.equal_parts KIND FIRST:END` prints the counts of `tests.cases.sure_heights` for boards of one
kind of part, `KIND` being one of `KINDS`.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from tests.cases.sure_heights import measure, print_counts
from vaoi_station.simulation import Twin, read_scenario, scenario_path


@dataclass(frozen=True)
class Kind:
    """Equal parts on a grid: the letters of their designators, and lengths in mm."""

    letters: str
    size_mm: tuple[float, float]
    pitch_mm: tuple[float, float]
    height_mm: float


KINDS = {
    "chips": Kind("C", (1.6, 0.8), (2.4, 1.6), 0.8),
    "connectors": Kind("J", (6.0, 4.0), (7.5, 5.5), 3.2),
    "headers": Kind("J", (2.3, 2.3), (2.54, 2.54), 2.5),
    "pads": Kind("TP", (0.9, 0.9), (1.27, 1.27), 0.0),
    "tall pins": Kind("J", (1.6, 1.6), (2.54, 2.54), 8.5),
}
WIDTH_MM, LENGTH_MM, BORDER_MM, CLEAR_MM = 96.0, 60.0, 8.0, 6.0


def board_type(kind: Kind) -> dict[str, object]:
    """Return a board type whose middle is filled with parts of one kind."""
    (width, height), (pitch_x, pitch_y) = kind.size_mm, kind.pitch_mm
    columns = int((WIDTH_MM - 2 * BORDER_MM) / pitch_x)
    rows = int((LENGTH_MM - 2 * BORDER_MM) / pitch_y)
    parts = [
        {
            "ref": f"{kind.letters}{row * columns + column + 1}",
            "center": [BORDER_MM + (column + 0.5) * pitch_x, BORDER_MM + (row + 0.5) * pitch_y],
            "width": width,
            "height": height,
            "rotation": 0.0,
            "body_height": kind.height_mm,
        }
        for row in range(rows)
        for column in range(columns)
    ]
    marks = [(4.0, 4.0), (WIDTH_MM - 4.0, 4.0), (4.0, LENGTH_MM - 7.0)]
    return {
        "name": "equal parts",
        "unit": "mm",
        "y_axis": "up",
        "side": "top",
        "outline": [[0, 0], [WIDTH_MM, 0], [WIDTH_MM, LENGTH_MM], [0, LENGTH_MM]],
        "fiducials": [{"name": f"F{k + 1}", "x": x, "y": y, "diameter": 1.0} for k, (x, y) in enumerate(marks)],
        "components": parts,
    }


def main() -> None:
    """Print the counts of some boards with parts of one kind."""
    name, boards = sys.argv[1:]
    first, end = map(int, boards.split(":"))
    with tempfile.TemporaryDirectory() as folder:
        board, scenario = Path(folder) / "board.json", Path(folder) / "scenario.toml"
        board.write_text(json.dumps(board_type(KINDS[name])))
        text = scenario_path("demo").read_text(encoding="utf-8")
        scenario.write_text(text.replace("[board]\n", f'[board]\nfile = "{board}"\n'), encoding="utf-8")
        twin = Twin(read_scenario(scenario))
        print_counts(sum((measure(twin, board) for board in range(first, end)), Counter()))


if __name__ == "__main__":
    main()
