"""Drawings of boards that are kept on disk."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station import compiled
from vaoi_station.simulation import read_scenario, scenario_path
from vaoi_station.simulation.board import kept_artwork
from vaoi_station.simulation.board.artwork import Artwork, draw
from vaoi_station.simulation.board.kept_artwork import kept_or_drawn
from vaoi_station.simulation.scenario import BoardSection


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Iterator[list[float]]:
    """The resolutions of all drawings that were made; the directory for what is kept is empty."""
    made: list[float] = []

    def counted(section: BoardSection, px_per_mm: float, belt_grey: float) -> Artwork:
        made.append(px_per_mm)
        return draw(section, px_per_mm, belt_grey)

    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kept"))
    compiled.cache_directory.cache_clear()
    monkeypatch.setattr(kept_artwork, "draw", counted)
    yield made
    compiled.cache_directory.cache_clear()


@pytest.fixture
def board() -> BoardSection:
    return read_scenario(scenario_path("small")).board


def same(a: Artwork, b: Artwork) -> bool:
    pairs = [(a.surface, b.surface), (a.metal, b.metal)]
    pairs += [(x.top, y.top) for x, y in zip(a.bodies, b.bodies, strict=True)]
    return all(np.array_equal(x, y) for x, y in pairs) and a.parts == b.parts and a.origin_mm == b.origin_mm


def test_a_kept_drawing_equals_the_drawn_one_and_cannot_be_changed(drawn: list[float], board: BoardSection) -> None:
    first, second = kept_or_drawn(board, 5.0, 20.0), kept_or_drawn(board, 5.0, 20.0)
    assert drawn == [5.0]
    assert same(first, second)
    assert not second.surface.flags.writeable
    assert not second.bodies[0].top.flags.writeable


def test_another_board_is_drawn_and_only_two_drawings_are_kept(
    drawn: list[float], board: BoardSection, tmp_path: Path
) -> None:
    for px_per_mm in (3.0, 4.0, 5.0, 5.0):
        kept_or_drawn(board, px_per_mm, 20.0)
    kept_or_drawn(board.model_copy(update={"seed": board.seed + 1}), 5.0, 20.0)
    assert drawn == [3.0, 4.0, 5.0, 5.0]
    assert len([*(tmp_path / "kept").iterdir()]) == 2


def test_an_incomplete_file_is_drawn_again(drawn: list[float], board: BoardSection, tmp_path: Path) -> None:
    first = kept_or_drawn(board, 5.0, 20.0)
    [file] = (tmp_path / "kept").iterdir()
    file.write_bytes(file.read_bytes()[:-7])
    assert same(kept_or_drawn(board, 5.0, 20.0), first)
    assert drawn == [5.0, 5.0]
