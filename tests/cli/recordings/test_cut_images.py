"""Options of `vaoi cut` that choose images, on a recording whose rows are lit from the left and right in turn."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.cli.recordings.cut_images import image_request
from vaoi_station.errors import InputError
from vaoi_station.files.images import read_image
from vaoi_station.rendering import ImageRequest


@pytest.fixture(scope="module")
def lit(small_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small recording with names of lights; frames are links to the originals."""
    case = tmp_path_factory.mktemp("lit") / "case"
    case.mkdir()
    for file in small_recording.iterdir():
        if file.name != "recording.json":
            (case / file.name).symlink_to(file)
    head = json.loads((small_recording / "recording.json").read_text())
    head["lights"] = [("left", "right")[row % 2] for row in range(head["rows"])]
    (case / "recording.json").write_text(json.dumps(head))
    return case


@pytest.fixture(scope="module")
def result(lit: Path) -> Path:
    from typer.testing import CliRunner

    from vaoi_station.cli import app

    out = lit.parent / "result.json"
    assert CliRunner().invoke(app, ["stitch", str(lit), "--out", str(out)]).exit_code == 0
    return out


def test_one_light_best_first(vaoi: Any, lit: Path, result: Path, tmp_path: Path) -> None:
    options = ("--component", "U1", "--light", "right", "--limit", 1, "--margin-mm", 1, "--align", "part")
    said = vaoi("cut", lit, "--result", result, *options, "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    [image] = json.loads((tmp_path / "U1.json").read_text())
    assert (image["light"], image["row"] % 2) == ("right", 1)
    expected = {"time_s", "exposure_us", "sharpness_per_mm", "saturated", "view_angle_deg", "sigma_px", "sigma_mm"}
    assert expected <= set(image)
    assert read_image(tmp_path / image["file"]).shape[:2] == (image["height_px"], image["width_px"])


def test_a_difference_and_a_plane_that_is_not_known(vaoi: Any, lit: Path, result: Path, tmp_path: Path) -> None:
    data = json.loads(result.read_text())
    data["quality"].update(heights_mm={}, height_sigma_mm={})
    board = json.loads((lit / "board.json").read_text())
    for part in board["components"]:
        part.pop("body_height", None)
    (tmp_path / "board.json").write_text(json.dumps(board))
    (tmp_path / "result.json").write_text(json.dumps(data))
    options = (
        "--component",
        "U1",
        "--light",
        "right",
        "--minus",
        "left",
        "--min-coverage",
        0.3,
        "--plane",
        "top",
        "--board",
    )
    said = vaoi(
        "cut", lit, "--result", tmp_path / "result.json", *options, tmp_path / "board.json", "--out", tmp_path / "out"
    )
    assert said.code == 0, said.err
    assert "U1: U1 has no height" in said.out
    listing = json.loads((tmp_path / "out" / "U1.json").read_text())
    assert listing
    for image in listing:
        assert (image["row"] % 2, image["minus"][1] % 2) == (1, 0)
        assert np.abs(read_image(tmp_path / "out" / image["file"]).astype(float).mean() - 128) < 40


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--light", "blue"), "light is 'blue', but must be one of the lights of this run: left, right"),
        (("--seen-from", "up"), "seen_from is 'up', but must be 'left' or 'right' or 'front' or 'back'"),
        (("--angle-deg", 50, 20), "min_angle_deg is 50.0, but must be at most max_angle_deg, 20"),
        (("--hdr", "--limit", 2), "--hdr merges all frames of a component under one light, so limit cannot be chosen"),
        (("--margin-mm", 90, "--px-per-mm", 200), "margin_mm is 90.0, but must be at most"),
    ],
)
def test_what_cannot_be_met_is_refused(
    vaoi: Any, lit: Path, result: Path, tmp_path: Path, options: Any, words: str
) -> None:
    said = vaoi("cut", lit, "--result", result, "--component", "U1", *options, "--out", tmp_path / "out")
    assert said.code == 2
    assert words in said.err
    assert not (tmp_path / "out").exists()


def test_options_make_the_request() -> None:
    wanted = image_request((10.0, 20.0), (5.0, 30.0), "120", light="left", limit=2)
    assert wanted == ImageRequest.of(
        {
            "min_exposure_us": 10.0,
            "max_exposure_us": 20.0,
            "min_angle_deg": 5.0,
            "max_angle_deg": 30.0,
            "seen_from": 120.0,
            "light": "left",
            "limit": 2,
            "measure": True,
        }
    )
    with pytest.raises(InputError, match="limit"):
        image_request(None, None, None, limit=0)
