from __future__ import annotations

from pathlib import Path
from typing import Any

from tests.photometry.white_recordings import film, white
from vaoi_station.photometry import FlatFields


def test_flat_fields_are_written_with_their_figures(vaoi: Any, tmp_path: Path) -> None:
    film(tmp_path / "white", white(120), lights=("even", "left"), rows=8)
    film(tmp_path / "dark", white(0))
    out = tmp_path / "flat"
    said = vaoi("flatfield", tmp_path / "white", "--dark", tmp_path / "dark", "--out", out)
    assert (said.code, said.err) == (0, "")
    assert "camera 1: dark level 3.0" in said.out
    assert "camera 0 under 'left': 0.4" in said.out
    assert f"4 flat fields → {out}" in said.out
    assert FlatFields.open(out).lights == ("even", "left")


def test_unfit_targets_and_existing_paths_are_refused(vaoi: Any, tmp_path: Path) -> None:
    film(tmp_path / "white", white(400))
    said = vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat")
    assert said.code == 2
    assert "of the pixels are saturated" in said.err
    assert not (tmp_path / "flat").exists()
    (tmp_path / "flat").mkdir()
    said = vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat")
    assert said.code == 2
    assert "exists already" in said.err


def test_missing_darkness_is_reported(vaoi: Any, tmp_path: Path) -> None:
    film(tmp_path / "white", white(120))
    said = vaoi("flatfield", tmp_path / "white", "--out", tmp_path / "flat")
    assert said.code == 0
    assert "a dark level of 0 is assumed" in said.out
