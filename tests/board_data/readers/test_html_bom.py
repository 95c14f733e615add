from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import pytest

from vaoi_station.board_data.design import rotated
from vaoi_station.board_data.readers.html_bom import read_html_bom
from vaoi_station.errors import InputError


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<html>", "has no readable pcbdata"),
        ("[1]", "pcbdata is a list"),
        ('{"footprints": [{"ref": "R1"}]}', "wrong value at 'bbox'"),
        ('{"footprints": [{"ref": "R1", "layer": "F", "bbox": {"pos": [1], "size": [1, 1]}}]}', "wrong value at"),
        ("[" * 100_000, "has no readable pcbdata"),
    ],
)
def test_wrong_files_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_html_bom(text.encode(), Path("b.json"))


PADS = ((0.5, 0.0), (7.0, 1.5), (7.5, -1.5))
"""Places of pads in a box from (0, -2) to (8, 2), y up."""


def page(
    angles: Sequence[float], *, sign: int = 1, mirrored: bool = False, layer: str = "B", offset: float = 0.0
) -> bytes:
    """Return data with boxes beside their origin, whose pads lie by a rule."""
    footprints = []
    for n, angle in enumerate(angles):
        at = [rotated((-x if mirrored else x, y), sign * angle + offset) for x, y in PADS]
        bbox = {"pos": [30 * n, -10], "relpos": [0, -2], "size": [8, 4], "angle": angle}
        pads = [{"pos": [30 * n + x, -10 - y]} for x, y in at]
        footprints.append({"ref": f"J{n}", "layer": layer, "bbox": bbox, "pads": pads})
    return json.dumps({"edges_bbox": {}, "footprints": footprints}).encode()


@pytest.mark.parametrize("layer", ["F", "B"])
@pytest.mark.parametrize("angles", [(0, 90, 180), (45, 135, 10), (270, 300)])
def test_boxes_in_which_the_pads_lie_are_as_the_page_draws_them(layer: str, angles: Sequence[float]) -> None:
    design = read_html_bom(page(angles, layer=layer), Path("b.json"))
    assert [part.rotation for part in design.parts] == list(angles)
    assert not design.notes


@pytest.mark.parametrize("layer", ["F", "B"])
@pytest.mark.parametrize(("sign", "mirrored"), [(-1, False), (1, True), (-1, True)])
def test_pads_show_that_a_generator_turns_boxes_otherwise(sign: int, mirrored: bool, layer: str) -> None:
    angles = (45, 90, 270, 30, 60)
    design = read_html_bom(page(angles, sign=sign, mirrored=mirrored, layer=layer), Path("b.json"))
    for n, (part, angle) in enumerate(zip(design.parts, angles, strict=True)):
        dx, dy = rotated((-4 if mirrored else 4, 0), sign * angle)
        assert part.center == pytest.approx((30 * n + dx, 10 + dy), abs=1e-6)
    (note,) = design.notes
    assert (note.code, note.values["fit"], note.values["parts"]) == ("boxes-by-pads", "5", "5")


@pytest.mark.parametrize("angle", [0, 360, 90])
def test_the_corner_of_a_box_is_no_origin_and_boxes_along_the_axes_state_no_angle(angle: float) -> None:
    bbox = {"relpos": [0, 0], "size": [8, 4], "angle": angle}
    footprints = [{"ref": f"R{n}", "layer": "F", "bbox": bbox | {"pos": [9 * n, -10]}} for n in range(3)]
    design = read_html_bom(json.dumps({"footprints": footprints}).encode(), Path("b.json"))
    x, y = (4, 8) if angle % 360 == 0 else (2, 14)
    for n, part in enumerate(design.parts):
        assert part.origin == part.center == pytest.approx((9 * n + x, y))
    assert [note.code for note in design.notes] == (["angles-not-stated"] if angle % 360 == 0 else [])
