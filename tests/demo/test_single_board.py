"""Prepare the output directory of a demo, and check the picture in the README."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.demo.single_board import PICTURES, REPORT, SHEET, prepare_output
from vaoi_station.errors import InputError
from vaoi_station.files.images import read_image
from vaoi_station.model import Status
from vaoi_station.rendering.contact_sheet import contact_sheet


def test_new_and_empty_directories_are_accepted(tmp_path: Path) -> None:
    prepare_output(tmp_path)
    prepare_output(tmp_path / "new")
    assert list(tmp_path.iterdir()) == []


def test_output_of_an_earlier_demo_is_deleted_and_other_files_stay(tmp_path: Path) -> None:
    (tmp_path / PICTURES / "U1").mkdir(parents=True)
    for name in (REPORT, SHEET, "mine.txt"):
        (tmp_path / name).write_text("x")
    prepare_output(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_directory_of_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / PICTURES).mkdir()
    with pytest.raises(InputError, match="holds files that no demo has written") as refusal:
        prepare_output(tmp_path)
    assert "another --out" in refusal.value.action
    assert (tmp_path / PICTURES).is_dir()
    file = tmp_path / "file"
    file.write_text("x")
    with pytest.raises(InputError, match="is a file"):
        prepare_output(file)


def test_picture_of_the_readme_is_a_small_contact_sheet() -> None:
    path = Path(__file__).resolve().parents[2] / "docs" / "pictures" / SHEET
    assert path.stat().st_size <= 400_000
    assert read_image(path).shape[1] == contact_sheet([], "demo", Status.OK, []).shape[1]
    assert f"docs/pictures/{SHEET}" in (path.parents[2] / "README.md").read_text(encoding="utf-8")
