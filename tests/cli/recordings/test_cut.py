"""`vaoi cut` from the outside: pictures, and the matrices that belong to them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import open_recording, read_board_type, read_stitch
from vaoi_station.files.images import read_image
from vaoi_station.geometry import apply
from vaoi_station.version import __version__


@pytest.fixture(scope="session")
def result(small_recording: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from typer.testing import CliRunner

    from vaoi_station.cli import app

    out = tmp_path_factory.mktemp("result") / "result.json"
    assert CliRunner().invoke(app, ["stitch", str(small_recording), "--out", str(out)]).exit_code == 0
    return out


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


def test_resolution_and_minimum_coverage(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    options = ("--component", "R1", "--px-per-mm", 9, "--min-coverage", 1)
    assert vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path).code == 0
    listing = json.loads((tmp_path / "R1.json").read_text())
    assert {(v["px_per_mm"], v["coverage"]) for v in listing} == {(9.0, 1.0)}


def test_unknown_component_is_refused_with_a_list_of_components(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    said = vaoi("cut", small_recording, "--result", result, "--component", "U99", "--out", tmp_path)
    assert said.code == 2
    assert "board type 'small' has no component 'U99'. It has " in said.err
    assert not list(tmp_path.glob("*.png"))


def test_run_without_cad_mapping_cannot_be_cut(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    data = json.loads(result.read_text())
    data.update(cad_matrix=None, status="failed", reasons=["the fiducials were not found"])
    (tmp_path / "failed.json").write_text(json.dumps(data))
    said = vaoi("cut", small_recording, "--result", tmp_path / "failed.json", "--component", "U1", "--out", tmp_path)
    assert said.code == 3
    assert "no CAD mapping" in said.err
    assert "the fiducials were not found" in said.err


def test_too_large_a_picture_is_refused(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    options = ("--component", "U1", "--px-per-mm", 1000)
    said = vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path)
    assert said.code == 2
    assert "U1: px_per_mm is 1000" in said.err
    assert "megapixels" in said.err


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


def test_result_of_another_board_of_the_same_array_is_refused(
    vaoi: Any, small_recording: Path, result: Path, tmp_path: Path
) -> None:
    assert vaoi("simulate", "small", "--board", 1, "--out", tmp_path / "board-1").code == 0
    said = vaoi("cut", tmp_path / "board-1", "--result", result, "--component", "U1", "--out", tmp_path / "cut")
    assert said.code == 2
    assert f"{result}: belongs to another recording: it was made from recording '{small_recording.name}'" in said.err
    assert "'board-1'" in said.err
    assert not (tmp_path / "cut").exists()


def test_version_is_printed(vaoi: Any) -> None:
    said = vaoi("--version")
    assert (said.code, said.out, said.err) == (0, f"vaoi_station {__version__}\n", "")


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


def test_all_components_at_once(vaoi: Any, small_recording: Path, result: Path, tmp_path: Path) -> None:
    options = ("--all", "--px-per-mm", 2)
    assert vaoi("cut", small_recording, "--result", result, *options, "--out", tmp_path).code == 0
    listed = {path.stem for path in tmp_path.glob("*.json")}
    assert listed == {c.address.replace("/", "_") for c in read_board_type(small_recording / "board.json").components}


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
