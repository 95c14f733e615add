"""`vaoi stitch` from the outside: a result, or one sentence that names the file and what is wrong with it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vaoi_station.files import read_stitch
from vaoi_station.files.images import read_image, write_image
from vaoi_station.model import Status


def edit(path: Path, change: Callable[[Any], Any]) -> None:
    """Change a document, past all checks: Python writes NaN as NaN."""
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))


def test_recording_becomes_a_result(vaoi: Any, small_recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "results" / "result.json"
    said = vaoi("stitch", small_recording, "--out", out)
    assert (said.code, said.err) == (0, "")
    assert said.out.startswith(f"ok: 6 rows × 2 cameras → {out}\nstandard deviation of positions: 0.0")
    result = read_stitch(out)
    assert result.status is Status.OK
    assert result.components
    assert result.quality["timings_ms"]


def test_calibration_and_board_type_of_other_directories(
    vaoi: Any, recording: Path, small_recording: Path, tmp_path: Path
) -> None:
    for name in ("calibration.json", "board.json"):
        (recording / name).rename(tmp_path / name)
    out = tmp_path / "result.json"
    given = ("--calibration", tmp_path / "calibration.json", "--board", tmp_path / "board.json")
    assert vaoi("stitch", recording, *given, "--out", out).code == 0
    assert vaoi("stitch", small_recording, "--out", tmp_path / "own.json").code == 0
    first, second = (read_stitch(path).model_dump(mode="json") for path in (out, tmp_path / "own.json"))
    assert first["cad_matrix"] == second["cad_matrix"]


def test_an_estimated_depth_of_16_bit_frames_is_stated(vaoi: Any, recording: Path, tmp_path: Path) -> None:
    for path in (recording / "frames").iterdir():
        write_image(path, read_image(path).astype(np.uint16) << 4)
    estimated = vaoi("stitch", recording, "--out", tmp_path / "estimated.json")
    assert "frames use 12 of 16 bits, by an estimate: state cameras[].bits in recording.json" in estimated.out
    edit(recording / "recording.json", lambda d: [camera.update(bits=12) for camera in d["cameras"]])
    assert "bits" not in vaoi("stitch", recording, "--out", tmp_path / "stated.json").out
    first, second = (read_stitch(tmp_path / name) for name in ("estimated.json", "stated.json"))
    assert (first.quality["estimated_bits"], "estimated_bits" in second.quality) == (12, False)
    assert first.model_dump()["components"] == second.model_dump()["components"]


def test_without_a_board_type_frames_are_placed_and_a_reason_is_given(
    vaoi: Any, recording: Path, tmp_path: Path
) -> None:
    (recording / "board.json").unlink()
    said = vaoi("stitch", recording, "--out", tmp_path / "r.json")
    assert said.code == 0
    assert "failed: 6 rows × 2 cameras" in said.out
    assert "- no board type was given" in said.out


@pytest.mark.parametrize("number", [1e308, -1e308, 1e150, 1e30, True])
@pytest.mark.parametrize(
    ("file", "keys"),
    [
        ("calibration.json", ("camera_matrices", 0, 0, 0)),
        ("calibration.json", ("camera_matrices", 1, 2, 2)),
        ("calibration.json", ("working_distance_mm",)),
        ("board.json", ("outline", 0, 0)),
        ("board.json", ("fiducials", 0, "x")),
        ("board.json", ("fiducials", 0, "diameter")),
        ("board.json", ("components", 0, "center", 1)),
        ("board.json", ("components", 0, "width")),
        ("board.json", ("components", 0, "body_height")),
        ("board.json", ("components", 0, "rotation")),
        ("recording.json", ("conveyor_mm_s", 1)),
        ("recording.json", ("trigger_period_s",)),
        ("recording.json", ("cameras", 0, "exposure_us")),
        ("recording.json", ("cameras", 0, "nominal_center_mm", 0)),
    ],
)
def test_absurd_numbers_are_refused_by_one_message(
    vaoi: Any, recording: Path, tmp_path: Path, file: str, keys: tuple[Any, ...], number: object
) -> None:
    def put(data: Any) -> None:
        for key in keys[:-1]:
            data = data[key]
        data[keys[-1]] = number

    edit(recording / file, put)
    said = vaoi("stitch", recording, "--out", tmp_path / "r.json")
    assert said.code == 2
    assert said.err.startswith(f"vaoi: {recording / file}: ")
    assert said.err.count("\n") == 1
    assert not (tmp_path / "r.json").exists()


def lose_a_frame(case: Path) -> None:
    (case / "frames" / "c01_r003.png").unlink()


def cut_a_frame(case: Path) -> None:
    path = case / "frames" / "c00_r002.png"
    path.write_bytes(path.read_bytes()[:200])


def crop_a_frame(case: Path) -> None:
    path = case / "frames" / "c00_r002.png"
    write_image(path, read_image(path)[:, :-8])


def newer_version(case: Path) -> None:
    edit(case / "recording.json", lambda d: d.update(version=7))


def foreign_calibration(case: Path) -> None:
    edit(case / "calibration.json", lambda d: d.update(format="opencv-calibration"))


def nan_in_a_matrix(case: Path) -> None:
    edit(case / "calibration.json", lambda d: d["camera_matrices"][1][0].__setitem__(2, float("nan")))


def one_matrix_too_few(case: Path) -> None:
    edit(case / "calibration.json", lambda d: (d["camera_matrices"].pop(), d.pop("distortion", None)))


def two_of_one_name(case: Path) -> None:
    edit(case / "board.json", lambda d: d["components"].append(dict(d["components"][0])))


def fiducial_outside(case: Path) -> None:
    edit(case / "board.json", lambda d: d["fiducials"][1].update(x=500.0))


def unknown_key(case: Path) -> None:
    edit(case / "board.json", lambda d: d.update(colour="green"))


def torn_document(case: Path) -> None:
    path = case / "recording.json"
    path.write_text(path.read_text()[:-40])


@pytest.mark.parametrize(
    ("spoil", "file", "said_of_it"),
    [
        (lose_a_frame, "c01_r003.png", "the frame is absent and not listed under 'missing'"),
        (cut_a_frame, "c00_r002.png", "may be incomplete"),
        (crop_a_frame, "c00_r002.png", "is 632×480 px, but recording.json says 640×480 px"),
        (newer_version, "recording.json", "version is 7, but must be 1"),
        (foreign_calibration, "calibration.json", "format is 'opencv-calibration'"),
        (nan_in_a_matrix, "calibration.json", "camera_matrices.1.0.2 is nan"),
        (one_matrix_too_few, "calibration.json", "camera_matrices has 1 entries, but 2 cameras were filming"),
        (two_of_one_name, "board.json", "twice; names must be unique"),
        (fiducial_outside, "board.json", "fiducial 'FID2' at (500.0, 5.6) lies outside the outline"),
        (unknown_key, "board.json", "unknown key(s) 'colour'"),
        (torn_document, "recording.json", "not valid JSON at line"),
    ],
)
def test_bad_input_is_one_sentence_that_names_the_file(
    vaoi: Any, recording: Path, tmp_path: Path, spoil: Callable[[Path], None], file: str, said_of_it: str
) -> None:
    spoil(recording)
    out = tmp_path / "result.json"
    said = vaoi("stitch", recording, "--out", out)
    assert said.code == 2
    assert said.out == ""
    assert said.err.startswith("vaoi: ")
    assert said.err.count("\n") == 1
    assert file in said.err
    assert said_of_it in said.err
    assert not out.exists(), "nothing half done is left behind"


def test_directory_without_a_recording_is_refused(vaoi: Any, tmp_path: Path) -> None:
    said = vaoi("stitch", tmp_path / "nowhere", "--out", tmp_path / "r.json")
    assert said.code == 2
    assert "nowhere/recording.json: there is no such file" in said.err


def test_frame_listed_as_missing_is_accepted(vaoi: Any, recording: Path, tmp_path: Path) -> None:
    lose_a_frame(recording)
    edit(recording / "recording.json", lambda d: d.update(missing=[[1, 3]]))
    assert vaoi("stitch", recording, "--out", tmp_path / "r.json").code == 0
    assert read_stitch(tmp_path / "r.json").status is Status.OK


def test_unknown_method_is_refused(vaoi: Any, small_recording: Path, tmp_path: Path) -> None:
    said = vaoi("stitch", small_recording, "--out", tmp_path / "r.json", "--method", "magic")
    assert said.code == 2
    assert "magic" in said.err
