"""The paper's methods on recorded boards, each with one kind of evidence."""

from __future__ import annotations

import io
import json
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from vaoi_station.cli import main
from vaoi_station.files import read_calibration, read_stitch, write_calibration
from vaoi_station.model import Status, Stitch

pytestmark = pytest.mark.cases


@dataclass(frozen=True)
class Result:
    """Exit code and errors of a command."""

    returncode: int
    stderr: str


def vaoi(*arguments: str | Path) -> Result:
    """Run `vaoi …` in this process."""
    errors = io.StringIO()
    with (
        patch.object(sys, "argv", ["vaoi", *map(str, arguments)]),
        redirect_stdout(io.StringIO()),
        redirect_stderr(errors),
        pytest.raises(SystemExit) as ended,
    ):
        main()
    code = ended.value.code
    return Result(code if isinstance(code, int) else 0, errors.getvalue())


def stitched(case: Path, out: Path, *options: str | Path) -> Stitch:
    done = vaoi("stitch", case, "--out", out, *options)
    assert done.returncode == 0, done.stderr
    return read_stitch(out)


def used(result: Stitch) -> dict[str, int]:
    return {kind: count["used"] for kind, count in result.quality["links"].items() if count["used"]}


@pytest.mark.parametrize(("name", "limit_px"), [("fixture", 0.15), ("paper-reference", 0.15)])
def test_fixture_marks_place_a_board_without_texture(cases: Any, tmp_path: Path, name: str, limit_px: float) -> None:
    result = stitched(cases(name), tmp_path / "result.json", "--method", "fiducials")
    assert (result.status, result.method) == (Status.OK, "fiducials")
    assert set(used(result)) == {"fiducials", "fixture"}
    assert cases.score(name, result)["cad_px"]["rms"] <= limit_px


@pytest.fixture(scope="module")
def taught(cases: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("taught") / "ulx3s"
    done = vaoi("teach", cases("ulx3s-top"), "--out", directory)
    assert done.returncode == 0, done.stderr
    assert not (directory / "truth.json").exists()
    return directory


def test_a_reference_places_a_later_board(cases: Any, taught: Path, tmp_path: Path) -> None:
    options = ("--method", "reference", "--reference", taught)
    result = stitched(cases("ulx3s-top-again"), tmp_path / "result.json", *options)
    assert (result.status, result.method) == (Status.OK, "reference")
    assert set(used(result)) == {"reference"}
    assert cases.score("ulx3s-top-again", result)["cad_px"]["rms"] <= 0.10
    np.testing.assert_allclose(result.row_motion[0], np.eye(3), atol=1e-12, err_msg="the gauge holds for every method")


def test_auto_uses_a_reference_and_all_other_evidence(cases: Any, taught: Path, tmp_path: Path) -> None:
    result = stitched(cases("ulx3s-top-again"), tmp_path / "result.json", "--reference", taught)
    assert set(used(result)) == {"rows", "neighbours", "fiducials", "reference"}
    assert cases.score("ulx3s-top-again", result)["cad_px"]["rms"] <= 0.08


def test_reference_with_another_calibration_is_refused(cases: Any, taught: Path, tmp_path: Path) -> None:
    case = cases("ulx3s-top-again")
    calibration = read_calibration(case / "calibration.json")
    moved = [m.copy() for m in calibration.camera_matrices]
    moved[1] = np.array([[1, 0, 3.0], [0, 1, 0], [0, 0, 1]]) @ moved[1]
    other = tmp_path / "other.json"
    write_calibration(other, calibration.model_copy(update={"camera_matrices": tuple(moved)}))
    done = vaoi("stitch", case, "--calibration", other, "--reference", taught, "--out", tmp_path / "r.json")
    assert done.returncode == 2
    assert "another calibration: camera 1 differs by 3.00 px" in done.stderr
    assert not (tmp_path / "r.json").exists()


def test_a_reference_of_another_board_type_is_refused(cases: Any, taught: Path, tmp_path: Path) -> None:
    case = cases("fixture")
    done = vaoi("stitch", case, "--reference", taught, "--method", "reference", "--out", tmp_path / "r.json")
    assert done.returncode == 2
    assert "whose components are not those of" in done.stderr


def test_a_run_that_is_not_ok_is_not_taught(cases: Any, tmp_path: Path) -> None:
    case = cases.copied("sparse", tmp_path / "case")
    board = json.loads((case / "board.json").read_text())
    board["fiducials"][0]["x"] += 5
    (case / "board.json").write_text(json.dumps(board))
    done = vaoi("teach", case, "--out", tmp_path / "reference")
    assert done.returncode == 2
    assert "cannot be a reference" in done.stderr
    assert list(tmp_path.glob("*reference*")) == []


@pytest.mark.parametrize("name", ["paper-1", "ulx3s-top"])
def test_method_of_the_paper_is_a_baseline(cases: Any, tmp_path: Path, name: str) -> None:
    theirs = stitched(cases(name), tmp_path / "result.json", "--method", "paper")
    assert (theirs.status, theirs.method) == (Status.DEGRADED, "paper")
    assert theirs.reasons == ("the paper's method has no measure of its own error",)
    error_px = cases.score(name, theirs)["cad_px"]["rms"]
    assert error_px < 1.0
    assert error_px > 3 * cases.score(name, cases.stitched(name))["cad_px"]["rms"]
