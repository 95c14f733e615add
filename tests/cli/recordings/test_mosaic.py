"""`vaoi mosaic` from the outside: the file, the document beside it, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from vaoi_station.files import open_recording, read_board_type, read_stitch
from vaoi_station.geometry import apply


def test_component_is_where_the_document_says(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    out = tmp_path / "board.tif"
    said = vaoi("mosaic", small_recording, "--result", result, "--out", out)
    assert (said.code, said.err) == (0, "")
    document = json.loads((tmp_path / "board.tif.json").read_text())
    picture = tifffile.imread(out)
    assert picture.shape == (document["height"], document["width"])
    assert (document["nodata"], document["covered"]) == (0, 1.0)
    assert f"{out}: {document['width']}×{document['height']} px" in said.out
    r1 = read_board_type(small_recording / "board.json").component("R1")
    stitch, recording = read_stitch(result), open_recording(small_recording)
    assert r1 is not None
    assert stitch.components is not None
    u, v = np.round(apply(document["image_from_cad"], r1.center)).astype(int)
    shown = picture[v - 3 : v + 4, u - 3 : u + 4].mean()
    differences = []
    for camera, row, x, y in stitch.components["R1"]:
        frame = recording.frame(camera, row)
        assert frame is not None
        i, j = round(x), round(y)
        differences.append(abs(frame[j - 3 : j + 4, i - 3 : i + 4].mean() - shown))
    assert min(differences) < 10


def test_region_and_resolution(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    low, _ = read_board_type(small_recording / "board.json").extent()
    box = (*low, *(low + (5, 4)))
    options = ("--region", *box, "--px-per-mm", 8, "--out", tmp_path / "r.tif")
    assert vaoi("mosaic", small_recording, "--result", result, *options).code == 0
    assert tifffile.imread(tmp_path / "r.tif").shape == (32, 40)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--light", "left"), "light is 'left', but must be one of the 1 lights of the run: 'ring'"),
        (("--exposure", 7), "exposure_us is 7.0, but must be one of the exposures of the run:"),
        (("--region", 900, 900, 901, 901), "region is '900, 900, 901, 901', but must be on the board"),
        (("--px-per-mm", 1000), "px_per_mm is 1000.0, but must be small enough for 1000 megapixels"),
        (("--flatfield", "nowhere"), "flatfield.json: there is no such file"),
        (("--hdr", "--heights", "nowhere.json"), "nowhere.json: there is no such file"),
    ],
)
def test_wrong_options_are_refused_and_nothing_is_written(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, options: Any, words: str
) -> None:
    said = vaoi("mosaic", small_recording, "--result", result, *options, "--out", tmp_path / "b.tif")
    assert said.code == 2
    assert words in said.err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["b.tif", "b.tif.json"])
def test_existing_output_is_refused(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("mine")
    said = vaoi("mosaic", small_recording, "--result", result, "--out", tmp_path / "b.tif")
    assert said.code == 2
    assert f"{tmp_path / name}: exists and is not overwritten" in said.err
    assert (tmp_path / name).read_text() == "mine"
