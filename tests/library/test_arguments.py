"""Wrong arguments of public functions are refused at the door, with name, value and what is expected."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vaoi_station as vaoi
from vaoi_station.library.arguments import require_number, require_path, require_text, require_whole, whole

WRONG_PATHS: list[Any] = [None, 5, b"a", ["a"], object(), "a\0b"]


@pytest.mark.parametrize("wrong", WRONG_PATHS)
@pytest.mark.parametrize(
    ("function", "name"),
    [
        (vaoi.read_calibration, "path"),
        (vaoi.read_board_type, "path"),
        (vaoi.read_result, "path"),
        (vaoi.read_image, "path"),
        (lambda path: vaoi.write_image(path, np.zeros((2, 2), np.uint8)), "path"),
        (vaoi.open_recording, "directory"),
        (vaoi.stitch, "directory"),
        (lambda path: vaoi.simulate("small", path), "directory"),
        (lambda path: vaoi.simulate(path, "x"), "scenario"),
    ],
)
def test_a_wrong_path_is_refused(function: Callable[[Any], object], name: str, wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match=rf"{name} is .*, but must be a path"):
        function(wrong)


@pytest.mark.parametrize("name", ["calibration", "board_type", "reference"])
def test_a_wrong_path_beside_the_recording_is_refused(recording: vaoi.RecordedRun, name: str) -> None:
    given: dict[str, Any] = {name: 5}
    with pytest.raises(vaoi.InputError, match=f"open_recording: {name} is 5, but must be a path"):
        vaoi.open_recording(recording.directory, **given)


def test_a_document_of_another_type_is_refused(
    recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun, tmp_path: Path
) -> None:
    wrong: Any = {"camera_matrices": []}
    with pytest.raises(vaoi.InputError, match=r"calibration is .* of type Calibration, not dict"):
        vaoi.write_calibration(tmp_path / "c.json", wrong)
    with pytest.raises(vaoi.InputError, match=r"board_type is .* of type BoardType, not Calibration"):
        vaoi.write_board_type(tmp_path / "b.json", recording.calibration)  # type: ignore[arg-type]
    with pytest.raises(vaoi.InputError, match=r"result is .* a path"):
        recording.with_result(wrong)
    with pytest.raises(vaoi.InputError, match="save: path is None"):
        stitched.save(None)  # type: ignore[arg-type]
    with pytest.raises(vaoi.InputError, match="pixels is"):
        vaoi.write_image(tmp_path / "a.png", [[1, 2], [3]])  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("wrong", [None, 5, "", ["U1"], b"U1"])
def test_a_wrong_ref_is_refused(stitched: vaoi.StitchedRun, wrong: Any) -> None:
    for function in (stitched.component, stitched.center):
        with pytest.raises(vaoi.InputError, match=r"ref is .* a text"):
            function(wrong)


@pytest.mark.parametrize("wrong", [0, -1, math.nan, math.inf, 1e6, 1e308, True, "40", [40.0]])
def test_a_wrong_resolution_is_refused_with_its_limits(stitched: vaoi.StitchedRun, wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match=r"px_per_mm is .*, but must be None or a number from 0\.1 to 1000"):
        stitched.component("U1", px_per_mm=wrong)


@pytest.mark.parametrize("wrong", [-0.1, 1.1, math.nan, math.inf, True, None, "0.5", 50])
def test_a_wrong_coverage_is_refused_with_its_limits(stitched: vaoi.StitchedRun, wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match=r"min_coverage is .*, but must be a number from 0 to 1"):
        stitched.component("U1", min_coverage=wrong)


def test_numbers_of_numpy_are_accepted(recording: vaoi.RecordedRun, stitched: vaoi.StitchedRun) -> None:
    assert recording.frame(np.int64(0), np.int32(1)) is not None  # type: ignore[arg-type]
    assert stitched.component("U1", px_per_mm=np.float32(8), min_coverage=np.float64(0.5)).images  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [None, 5, ["auto"], "AUTO"])
def test_a_wrong_method_is_refused(recording: vaoi.RecordedRun, wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match="method is"):
        recording.stitch(wrong)


@pytest.mark.parametrize("wrong", [None, 1.0, "1", True, -1, 10**9])
def test_a_wrong_board_number_is_refused(tmp_path: Path, wrong: Any) -> None:
    with pytest.raises(vaoi.InputError, match=r"board is .*, but must be a whole number from 0"):
        vaoi.simulate("small", tmp_path, board=wrong)
    assert not list(tmp_path.iterdir())


def test_checks_return_the_argument() -> None:
    assert require_path("f", "p", "a/b") == Path("a/b") == require_path("f", "p", Path("a/b"))
    assert require_text("f", "t", "x") == "x"
    assert require_whole("f", "n", np.uint8(7), 0, 9) == 7
    assert require_number("f", "x", 3, 0, 9) == 3.0
    assert (whole(3), whole(True), whole(3.0), whole("3")) == (3, None, None, None)
    with pytest.raises(vaoi.InputError, match="f: x is nan, but must be a number from 0 to 9"):
        require_number("f", "x", math.nan, 0, 9)
