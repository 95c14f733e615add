"""Single documents through the public API."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import vaoi_station as vaoi


def test_documents_are_written_as_they_are_read(recording: vaoi.RecordedRun, tmp_path: Path) -> None:
    calibration = vaoi.read_calibration(str(recording.directory / "calibration.json"))
    vaoi.write_calibration(tmp_path / "c.json", calibration)
    np.testing.assert_array_equal(
        vaoi.read_calibration(tmp_path / "c.json").camera_matrices, recording.calibration.camera_matrices
    )
    board_type = vaoi.read_board_type(recording.directory / "board.json")
    vaoi.write_board_type(str(tmp_path / "b.json"), board_type)
    assert vaoi.read_board_type(tmp_path / "b.json") == board_type == recording.board_type


@pytest.mark.parametrize(
    ("name", "pixels", "words"),
    [
        ("a.png", np.full((2, 2), 0.5), "float64"),
        ("a.png", np.zeros((2, 2), np.int32), "int32"),
        ("a.png", np.zeros((0, 0), np.uint8), "shape"),
        ("a.png", np.zeros((2, 2, 4), np.uint8), "shape"),
        ("a.jpg", np.zeros((2, 2), np.uint8), "ends in .png"),
        ("a", np.zeros((2, 2), np.uint8), "ends in .png"),
    ],
)
def test_pixels_that_a_file_cannot_hold_are_refused(tmp_path: Path, name: str, pixels: np.ndarray, words: str) -> None:
    with pytest.raises(vaoi.InputError, match=words):
        vaoi.write_image(tmp_path / name, pixels)
    assert not list(tmp_path.iterdir())
