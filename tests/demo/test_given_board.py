"""A given board type on the twin: drawn where its data say, found again by the station, refused if it is too wide."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.demo.given_board import LEAST_PX_PER_MM, MOST_CAMERAS, write_given_scenario
from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import apply
from vaoi_station.library.recordings import simulate
from vaoi_station.simulation import read_scenario


def board_file(folder: Path, **changed: Any) -> Path:
    """A board of 40 × 30 mm whose coordinates begin at (100, -70), in the unit and axes of the file."""
    content = {
        "name": "given",
        "outline": [[100, -70], [140, -70], [140, -40], [100, -40]],
        "fiducials": [
            {"name": "F1", "x": 104, "y": -66, "diameter": 1},
            {"name": "F2", "x": 136, "y": -45, "diameter": 1},
            {"name": "F3", "x": 132, "y": -66, "diameter": 1},
        ],
        "components": [
            {"ref": "F1", "center": [104, -66], "width": 1, "height": 1},
            {"ref": "U1", "center": [120, -55], "width": 8, "height": 5, "rotation": 30, "body_height": 1.5},
            {"ref": "J1", "center": [102, -50], "width": 3, "height": 9},
            *(
                {"ref": f"R{n}", "center": [110 + 4 * n, -47 - 2 * n], "width": 1.6, "height": 0.8, "rotation": 90}
                for n in range(5)
            ),
        ],
    }
    path = folder / "given.json"
    path.write_text(json.dumps(content | changed), encoding="utf-8")
    return path


@pytest.mark.parametrize("changed", [{}, {"side": "bottom", "y_axis": "down"}], ids=["top, y up", "bottom, y down"])
def test_the_station_finds_the_board_where_its_data_say(tmp_path: Path, changed: dict[str, Any]) -> None:
    scenario = write_given_scenario(board_file(tmp_path, **changed), "small", tmp_path)
    run = simulate(scenario, tmp_path / "recording")
    result = run.stitch()
    assert result.status == "ok", result.reasons
    truth = json.loads((tmp_path / "recording" / "truth.json").read_text(encoding="utf-8"))
    places = [c.center for c in run.board_type.components] if run.board_type else []
    assert len(places) == 8
    found, true = (apply(np.asarray(m), places) for m in (result.cad_matrix, truth["cad_matrix"]))
    assert np.abs(found - true).max() < 0.01


def test_cameras_are_added_then_the_resolution_is_lowered(tmp_path: Path) -> None:
    def array(width_mm: float) -> tuple[int, float]:
        outline = [[0, 0], [width_mm, 0], [width_mm, 30], [0, 30]]
        file = board_file(tmp_path, outline=outline, components=[], fiducials=[])
        given = read_scenario(write_given_scenario(file, "demo", tmp_path))
        assert given.board.width_mm == width_mm
        return given.array.cameras, given.array.px_per_mm

    assert array(30) == (2, 40.0)
    assert array(100) == (4, 40.0)
    cameras, px_per_mm = array(400)
    assert cameras == MOST_CAMERAS
    assert LEAST_PX_PER_MM < px_per_mm < 40
    with pytest.raises(InputError, match=r"outline is 2000\.0 mm wide, the demo films at most 99\d mm"):
        array(2000)


def test_a_board_type_without_outline_is_refused(tmp_path: Path) -> None:
    file = board_file(tmp_path)
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["outline"]
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match="outline is absent"):
        write_given_scenario(file, "small", tmp_path)
