"""The painted board: fiducials, belt, metal and lettering at their places."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.simulation.board.artwork import Artwork, draw
from vaoi_station.simulation.scenario import BoardSection

PX_PER_MM, BELT = 12.0, 18.0
SECTION = BoardSection(width_mm=50.0, length_mm=46.0, density=1.5)


@pytest.fixture(scope="module")
def artwork() -> Artwork:
    return draw(SECTION, PX_PER_MM, BELT)


def at(artwork: Artwork, place: tuple[float, float]) -> tuple[int, int]:
    """Grey value and metal share at a board place."""
    x, y = artwork.to_px(np.array(place)).round().astype(int)
    return int(artwork.surface[y, x]), int(artwork.metal[y, x])


def bare(**changes: object) -> BoardSection:
    """A board without parts."""
    return BoardSection.model_validate({"width_mm": 30.0, "length_mm": 20.0, "density": 0.0, **changes})


def test_the_edge_of_the_board_lies_at_its_exact_place() -> None:
    """Along a line across the left edge the grey values change at x = 0, to a hundredth of a pixel."""
    art = draw(bare(fiducials=()), PX_PER_MM, BELT)
    row = art.surface[int(art.to_px(np.array([0.0, 10.3]))[1]), :40].astype(float)
    # between belt and copper area lies half a millimetre of bare mask: the step is belt → mask
    mask = float(np.median(row[4:7]))
    edge_px = ((mask - row[:5]) / (mask - BELT)).clip(0, 1).sum() - 0.5
    assert edge_px == pytest.approx(art.to_px(np.array([0.0, 0.0]))[0], abs=0.15)


@pytest.mark.parametrize(
    ("shape", "area"), [("circle", np.pi), ("square", 4.0), ("diamond", 2.0), ("cross", 2 * 2 * 0.5 - 0.25)]
)
def test_the_copper_of_a_fiducial_has_its_exact_area_and_centre(shape: str, area: float) -> None:
    place = (12.34, 9.71)
    marks = [{"x_mm": place[0], "y_mm": place[1], "diameter_mm": 2.0, "shape": shape}]
    art = draw(bare(fiducials=marks), PX_PER_MM, BELT)
    x, y = art.to_px(np.array(place)).round().astype(int)
    share = art.metal[y - 20 : y + 21, x - 20 : x + 21] / 255.0
    assert share.sum() / PX_PER_MM**2 == pytest.approx(area, rel=0.01)
    rows, columns = np.mgrid[y - 20 : y + 21, x - 20 : x + 21]
    center = np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()
    assert np.abs(center - art.to_px(np.array(place))).max() < 0.02
