"""`vaoi cut --hdr` from the outside: merged pictures and their listings."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.files import open_recording
from vaoi_station.files.images import read_image


def test_merged_pictures_with_their_sigma_and_listing(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    options = ("--component", "U1", "--hdr", "--format", "npy", "--sigma")
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    # The small recording has one exposure: that is answered, and said.
    assert "1 exposure(s)" in said.out
    assert "only one exposure shows it" in said.out
    listing = json.loads((tmp_path / "U1.json").read_text())
    assert listing[-1]["file"] == "U1_hdr.npy"
    assert [e["file"] for e in listing[:-1]] == [f"U1_hdr_{k:02d}.npy" for k in range(len(listing) - 1)]
    merged = [len(e["merged"]) for e in listing]
    assert merged[-1] == max(merged) > 1
    head = open_recording(small_recording).head
    last = listing[-1]
    assert last["merged"][0] == [last["camera"], last["row"]]
    value, sigma = np.load(tmp_path / last["file"]), np.load(tmp_path / last["sigma_file"])
    assert value.dtype == sigma.dtype == np.float32
    assert value.shape == sigma.shape
    assert np.isfinite(value).mean() > 0.9
    plain = vaoi("cut", small_recording, "--result", result, "--component", "U1", "--out", tmp_path / "plain")
    assert plain.code == 0
    first = json.loads((tmp_path / "plain" / "U1.json").read_text())[0]
    np.testing.assert_allclose(last["crop_from_cad"], first["crop_from_cad"])
    picture = read_image(tmp_path / "plain" / first["file"])
    grey = value * head.exposure_us(first["camera"], first["row"])
    usable = np.isfinite(grey) & (picture < 250) & (picture > 5)
    assert abs(grey[usable].mean() / picture[usable].mean() - 1) < 0.1


def test_frames_of_one_light_are_merged(vaoi: Any, recording: Path, result: Path, tmp_path: Path) -> None:
    """Of most frames, or the one that is named: metal looks another way under every light."""
    head = json.loads((recording / "recording.json").read_text())
    head["lights"] = ["left" if row % 3 else "even" for row in range(head["rows"])]
    (recording / "recording.json").write_text(json.dumps(head))
    for options, light in (((), "left"), (("--light", "even"), "even")):
        out = tmp_path / light
        said = vaoi("cut", recording, "--result", result, "--component", "U1", "--hdr", *options, "--out", out)
        assert (said.code, said.err) == (0, "")
        assert f"under the light '{light}'" in said.out
        listing = json.loads((out / "U1.json").read_text())
        assert {e["light"] for e in listing} == {light}
        rows_of = {row for entry in listing for _, row in entry["merged"]}
        assert {row % 3 == 0 for row in rows_of} == {light == "even"}
    said = vaoi("cut", recording, "--result", result, "--component", "U1", "--hdr", "--light", "blue", "--out", out)
    assert said.code == 2
    assert "light is 'blue', but must be one of the lights of the run: 'even', 'left'" in said.err


@pytest.mark.parametrize("options", [("--hdr",), ("--plane", "top")])
def test_measured_heights_give_the_plane(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, options: Any
) -> None:
    """The same one in merged pictures as in those of the top plane."""
    (tmp_path / "h.json").write_text(json.dumps({"U1": {"height_mm": 1.375, "sigma_mm": 0.02, "views": 4}}))
    options = (*options, "--component", "U1", "--heights", tmp_path / "h.json")
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    listing = json.loads((tmp_path / "U1.json").read_text())
    assert {entry.get("plane_height_mm", entry.get("height_mm")) for entry in listing} == {1.375}


@pytest.mark.parametrize("form", ["tiff", "png", "jpeg"])
def test_formats_of_a_region(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, form: str) -> None:
    options = ("--region", 5, 5, 12, 9, "--hdr", "--format", form, "--px-per-mm", 5)
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    listing = json.loads((tmp_path / "region.json").read_text())
    picture = cv2.imread(str(tmp_path / listing[-1]["file"]), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.shape == (20, 35)
    assert picture.dtype == (np.float32 if form == "tiff" else np.uint8)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--region", 900, 900, 910, 910), "must be on the board, which reaches from"),
        (("--region", 5, 5, 4, 9), "X0 < X1"),
        (("--component", "U1", "--format", "png", "--sigma"), "only npy and tiff hold a standard deviation"),
        (("--component", "U1", "--flatfield", "nowhere"), "flatfield.json: there is no such file"),
    ],
)
def test_bad_input_is_refused(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, options: Any, words: str
) -> None:
    said = vaoi("cut", small_recording, "--result", result, *options, "--hdr", "--out", tmp_path)
    assert said.code == 2
    assert words in said.err


def test_flat_fields_of_another_array_are_refused(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    from tests.photometry.white_recordings import film, white

    film(tmp_path / "white", white(120))
    assert vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat").code == 0
    options = ("--component", "U1", "--hdr", "--flatfield", tmp_path / "flat")
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert said.code == 2
    assert "px, but its frames have" in said.err or "are of an array of 2 cameras" in said.err
