"""The painted board: fiducials, belt, metal and lettering at their places."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.simulation.board.artwork import COPPER, LAMINATE, RIM_PX, Artwork, draw
from vaoi_station.simulation.scenario import BoardSection, FiducialMark

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


def test_the_texture_covers_the_board_and_a_margin_of_belt(artwork: Artwork) -> None:
    h, w = artwork.surface.shape
    assert w >= SECTION.width_mm * PX_PER_MM + 2 * RIM_PX
    assert h >= SECTION.length_mm * PX_PER_MM + 2 * RIM_PX
    border = np.concatenate([artwork.surface[0], artwork.surface[:, 0], artwork.surface[-1], artwork.surface[:, -1]])
    assert set(np.unique(border)) == {int(BELT)}
    assert artwork.metal[0].max() == 0


def test_the_edge_of_the_board_lies_at_its_exact_place() -> None:
    """Along a line across the left edge the grey values change at x = 0, to a hundredth of a pixel."""
    art = draw(bare(fiducials=()), PX_PER_MM, BELT)
    row = art.surface[int(art.to_px(np.array([0.0, 10.3]))[1]), :40].astype(float)
    # between belt and copper area lies half a millimetre of bare mask: the step is belt → mask
    mask = float(np.median(row[4:7]))
    edge_px = ((mask - row[:5]) / (mask - BELT)).clip(0, 1).sum() - 0.5
    assert edge_px == pytest.approx(art.to_px(np.array([0.0, 0.0]))[0], abs=0.15)


@pytest.mark.parametrize("shape", ["circle", "cross", "square", "diamond"])
def test_fiducials_are_bare_copper_in_a_ring_without_mask(shape: str) -> None:
    mark = FiducialMark.model_validate({"x_mm": 12.3, "y_mm": 9.7, "diameter_mm": 2.0, "shape": shape})
    art = draw(bare(fiducials=[mark.model_dump()]), PX_PER_MM, BELT)
    assert at(art, (12.3, 9.7)) == (int(COPPER), 255)
    for x, y in ((12.3 + 1.7, 9.7), (12.3, 9.7 + 1.7), (12.3 - 1.3, 9.7 - 1.3)):
        assert at(art, (x, y)) == (int(LAMINATE), 0)


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


def test_pads_are_metal_and_solder_mask_is_not(artwork: Artwork) -> None:
    for part in artwork.parts[:10]:
        u, v, *_ = part.package.pads[0]
        assert at(artwork, part.to_board_point(u, v))[1] == 255
    assert 0.01 < np.mean(artwork.metal > 128) < 0.3


def test_textures_cannot_be_changed(artwork: Artwork) -> None:
    for texture in (artwork.surface, artwork.metal, *(body.top for body in artwork.bodies[:2])):
        with pytest.raises(ValueError, match="read-only"):
            texture[0, 0] = 1
