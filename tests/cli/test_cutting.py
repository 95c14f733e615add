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
