"""`vaoi cut`: component pictures from frames, chosen or merged."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import open_recording, read_board_type, read_stitch
from vaoi_station.files.images import read_image
from vaoi_station.geometry import apply


def test_pictures_of_components_with_their_matrices(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    said = vaoi("cut", small_recording, "--result", result, "--component", "U1", "--component", "R1", "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    stitch, recording = read_stitch(result), open_recording(small_recording)
    r1 = read_board_type(small_recording / "board.json").component("R1")
    assert r1 is not None
    assert f"U1: {len(json.loads((tmp_path / 'U1.json').read_text()))} image(s) → {tmp_path}" in said.out
    listing = json.loads((tmp_path / "R1.json").read_text())
    assert listing
    assert [v["coverage"] for v in listing] == sorted((v["coverage"] for v in listing), reverse=True)
    assert stitch.components is not None
    shown = {(i, j): (x, y) for i, j, x, y in stitch.components["R1"]}
    for k, view in enumerate(listing):
        assert view["file"] == f"R1_{k:02d}_c{view['camera']:02d}_r{view['row']:03d}.png"
        picture = read_image(tmp_path / view["file"])
        middle = apply(view["crop_from_cad"], r1.center)
        assert middle == pytest.approx([(picture.shape[1] - 1) / 2, (picture.shape[0] - 1) / 2])
        np.testing.assert_allclose(np.array(view["cad_from_crop"]) @ view["crop_from_cad"], np.eye(3), atol=1e-9)
        in_frame = apply(view["image_from_crop"], middle)
        assert in_frame == pytest.approx(shown[view["camera"], view["row"]], abs=0.05)
        frame = recording.frame(view["camera"], view["row"])
        assert frame is not None
        x, y = np.round(in_frame).astype(int)
        u, v = np.round(middle).astype(int)
        assert abs(picture[v - 3 : v + 4, u - 3 : u + 4].mean() - frame[y - 3 : y + 4, x - 3 : x + 4].mean()) < 6
    assert listing[0]["coverage"] == 1


def test_unknown_component_is_refused_with_a_list_of_components(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    said = vaoi("cut", small_recording, "--result", result, "--component", "U99", "--out", tmp_path)
    assert said.code == 2
    assert "board type 'small' has no component 'U99'. It has " in said.err
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: [m.pop() for m in (*d["image_matrices"], d["row_motion"])], "rows, the recording has"),
        (lambda d: d["image_matrices"][1][0][0].__setitem__(2, 7.0), "camera 1 has another calibration"),
    ],
)
def test_result_of_another_recording_is_refused(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, change: Any, words: str
) -> None:
    data = json.loads(result.read_text())
    change(data)
    (tmp_path / "other.json").write_text(json.dumps(data))
    said = vaoi("cut", small_recording, "--result", tmp_path / "other.json", "--component", "U1", "--out", tmp_path)
    assert said.code == 2
    assert "belongs to another recording" in said.err
    assert words in said.err
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ((), "0 of --component, --all and --region were given, but it must be one"),
        (("--component", "U1", "--all"), "2 of --component, --all and --region"),
        (("--component", "U1", "--sigma"), "--sigma was given without --hdr"),
        (("--region", 1, 1, 5, 5), "--region was given without --hdr"),
        (("--component", "U1", "--format", "npy"), "--format was given without --hdr"),
    ],
)
def test_options_that_exclude_each_other(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path, options: Any, words: str
) -> None:
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert said.code == 2
    assert words in said.err


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_recording_whose_files_have_byte_order_marks_is_stitched_and_cut(
    vaoi: Any, recording: Path, tmp_path: Path, encoding: str
) -> None:
    result, flat = tmp_path / "result.json", tmp_path / "plain.json"
    assert vaoi("stitch", recording, "--out", flat).code == 0
    for name in ("recording.json", "board.json", "calibration.json"):
        (recording / name).write_bytes((recording / name).read_text().encode(encoding))
    assert vaoi("stitch", recording, "--out", result).code == 0
    assert json.loads(result.read_text())["image_matrices"] == json.loads(flat.read_text())["image_matrices"]
    result.write_bytes(result.read_text().encode(encoding))
    said = vaoi("cut", recording, "--result", result, "--component", "U1", "--out", tmp_path / "cut")
    assert (said.code, said.err) == (0, "")
    assert list((tmp_path / "cut").glob("U1_*.png"))


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
def lit_result(lit: Path) -> Path:
    from typer.testing import CliRunner

    from vaoi_station.cli import app

    out = lit.parent / "result.json"
    assert CliRunner().invoke(app, ["stitch", str(lit), "--out", str(out)]).exit_code == 0
    return out


def test_one_light_best_first(vaoi: Any, lit: Path, lit_result: Path, tmp_path: Path) -> None:
    options = ("--component", "U1", "--light", "right", "--limit", 1, "--margin-mm", 1, "--align", "part")
    said = vaoi("cut", lit, "--result", lit_result, *options, "--out", tmp_path)
    assert (said.code, said.err) == (0, "")
    [image] = json.loads((tmp_path / "U1.json").read_text())
    assert (image["light"], image["row"] % 2) == ("right", 1)
    expected = {"time_s", "exposure_us", "sharpness_per_mm", "saturated", "view_angle_deg", "sigma_px", "sigma_mm"}
    assert expected <= set(image)
    assert read_image(tmp_path / image["file"]).shape[:2] == (image["height_px"], image["width_px"])


def test_a_difference_and_a_plane_that_is_not_known(vaoi: Any, lit: Path, lit_result: Path, tmp_path: Path) -> None:
    data = json.loads(lit_result.read_text())
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
    vaoi: Any, lit: Path, lit_result: Path, tmp_path: Path, options: Any, words: str
) -> None:
    said = vaoi("cut", lit, "--result", lit_result, "--component", "U1", *options, "--out", tmp_path / "out")
    assert said.code == 2
    assert words in said.err
    assert not (tmp_path / "out").exists()
