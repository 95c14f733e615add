"""Wrong arguments of public functions are refused at the door, with name, value and what is expected."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import vaoi_station as vaoi

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
