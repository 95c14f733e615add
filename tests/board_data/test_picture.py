from __future__ import annotations

from xml.etree import ElementTree as ET

import pytest

from vaoi_station.board_data.picture import board_picture
from vaoi_station.model import BoardType

MARK = {"name": "<F1>", "x": 10, "y": 5, "diameter": 2}
BOARD = {
    "name": "a & b",
    "outline": [[0, 0], [100, 50]],
    "cut_outs": [[[1, 1], [2, 1], [2, 2]]],
    "fiducials": [MARK],
    "other_marks": [{**MARK, "x": -20, "kind": "panel"}],
    "components": [{"ref": "U1", "center": [30, 20], "width": 4, "height": 2, "size_from": "guess"}],
}
NS = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize(
    ("side", "y_axis", "at"), [("top", "up", (10, -5)), ("bottom", "up", (-10, -5)), ("top", "down", (10, 5))]
)
def test_it_is_valid_and_shows_the_side_as_a_person_sees_it(side: str, y_axis: str, at: tuple[float, float]) -> None:
    root = ET.fromstring(board_picture(BoardType.model_validate({**BOARD, "side": side, "y_axis": y_axis})))
    mark, panel = root.findall(f"{NS}circle")
    assert (float(mark.get("cx", "")), float(mark.get("cy", ""))) == at
    assert [t.text for t in root.iter(f"{NS}title")] == [f"a & b, {side}", "<F1>", "<F1> (panel)"]
    x, y, width, height = map(float, root.get("viewBox", "").split())
    assert x <= float(panel.get("cx", "")) <= x + width
    assert y <= float(panel.get("cy", "")) <= y + height
