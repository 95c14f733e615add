"""The commands that work on one recording."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.cli.conftest import Result
from tests.identity.conftest import DATAMATRIX
from vaoi_station.cli import app
from vaoi_station.errors import InputError
from vaoi_station.files import open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.images import read_image, write_image
from vaoi_station.files.results import write_stitch
from vaoi_station.model import Status, Stitch
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.recording_writer import write_passage


def _run(*arguments: str) -> str:
    result = CliRunner().invoke(app, ["simulate", *arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_recording_is_complete(tmp_path: Path) -> None:
    out = tmp_path / "board"
    said = _run("small", "--out", str(out), "--board", "1")
    recording = open_recording(out)
    assert "2 cameras × 6 rows" in said
    assert recording.head.rows == 6
    assert read_calibration(out / "calibration.json", 2).working_distance_mm == 300
    assert read_board_type(out / "board.json").component("U1") is not None
    assert (out / "truth.json").exists()
    with pytest.raises(InputError, match="already holds"):
        _run("small", "--out", str(out))


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


def crop_a_frame(case: Path) -> None:
    path = case / "frames" / "c00_r002.png"
    write_image(path, read_image(path)[:, :-8])


def nan_in_a_matrix(case: Path) -> None:
    edit(case / "calibration.json", lambda d: d["camera_matrices"][1][0].__setitem__(2, float("nan")))


def unknown_key(case: Path) -> None:
    edit(case / "board.json", lambda d: d.update(colour="green"))


def torn_document(case: Path) -> None:
    path = case / "recording.json"
    path.write_text(path.read_text()[:-40])


@pytest.mark.parametrize(
    ("spoil", "file", "said_of_it"),
    [
        (lose_a_frame, "c01_r003.png", "the frame is absent and not listed under 'missing'"),
        (crop_a_frame, "c00_r002.png", "is 632×480 px, but recording.json says 640×480 px"),
        (nan_in_a_matrix, "calibration.json", "camera_matrices.1.0.2 is nan"),
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


def test_reference_is_kept_and_never_overwritten(
    vaoi: Callable[..., Result], small_recording: Path, tmp_path: Path
) -> None:
    out = tmp_path / "reference"
    done = vaoi("teach", small_recording, "--out", out)
    assert done.code == 0, done.err
    assert done.out.startswith("ok: standard deviation of positions 0.0")
    assert open_recording(out).head == open_recording(small_recording).head
    refused = vaoi("teach", small_recording, "--out", out)
    assert refused.code == 2
    assert "exists already" in refused.err


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "run"
    done = CliRunner().invoke(app, ["simulate", "small", "--out", str(out)])
    assert done.exit_code == 0, done.output
    return out


def test_report_is_one_file(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "r.html"
    done = CliRunner().invoke(app, ["report", str(run), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert done.output.strip() == f"ok: {out}"
    assert out.read_text().startswith("<!doctype html>")


def test_bundle_can_be_stitched_and_reported_again(run: Path, tmp_path: Path) -> None:
    kept = tmp_path / "kept"
    done = CliRunner().invoke(app, ["report", str(run), "--bundle", str(kept)])
    assert done.exit_code == 0, done.output
    assert f"vaoi stitch {kept} --method auto --out again.json" in done.output
    again = CliRunner().invoke(app, ["stitch", str(kept), "--out", str(tmp_path / "again.json")])
    assert again.exit_code == 0
    both = ["report", str(kept), "--out", str(tmp_path / "r.html"), "--bundle", str(tmp_path / "second")]
    assert CliRunner().invoke(app, both).exit_code == 0
    assert (tmp_path / "r.html").is_file()
    refused = CliRunner().invoke(app, ["report", str(run), "--bundle", str(kept)])
    assert isinstance(refused.exception, InputError)


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


@pytest.fixture(scope="module")
def coded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A recording of a small board with a code, and its result from the truth."""
    return record(tmp_path_factory.mktemp("identify"), DATAMATRIX)


def record(folder: Path, code: dict[str, Any]) -> tuple[Path, Path]:
    scenario = {
        "array": {"cameras": 1, "width_px": 320, "height_px": 240, "px_per_mm": 16.0, "working_distance_mm": 250.0},
        "board": {"name": "coded", "width_mm": 18.0, "length_mm": 16.0, "density": 0.0, "codes": [code]},
        "line": {"barrier_mm": -15.0, "start_delay_s": 0.1, "period_s": 0.04, "tail_s": 0.1},
    }
    passage = Twin(Scenario.model_validate(scenario)).passage(41)
    truth = passage.truth()
    write_passage(passage, folder / "run")
    keys = ("image_matrices", "cad_matrix", "row_motion")
    write_stitch(folder / "result.json", Stitch(method="auto", status=Status.OK, **{key: truth[key] for key in keys}))
    return folder / "run", folder / "result.json"
