"""Every package is a plausible footprint: pads, leads and body agree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.board.packages import (
    BIG,
    MIDDLE,
    SMALL,
    Box,
    Finish,
    Package,
    can_capacitor,
    chip,
    header,
    quad_flat,
    small_outline,
    socket,
    sot23,
)

ALL = {package.name + package.prefix: package for package in (make() for make in (*BIG, *MIDDLE, *SMALL))}
SIZE = st.floats(0.3, 8.0)


def extents(boxes: tuple[Box, ...]) -> np.ndarray:
    """Low u, low v, high u, high v of each box, (k, 4)."""
    b = np.array(boxes)
    return np.column_stack([b[:, :2] - b[:, 2:] / 2, b[:, :2] + b[:, 2:] / 2])


def overlap(boxes: tuple[Box, ...]) -> bool:
    """Whether two of the boxes overlap."""
    e = extents(boxes)
    return any(
        (np.minimum(e[i, 2:], e[j, 2:]) - np.maximum(e[i, :2], e[j, :2]) > 1e-9).all()
        for i in range(len(e))
        for j in range(i)
    )


@pytest.mark.parametrize("name", ALL)
def test_pads_are_separate_and_have_an_area(name: str) -> None:
    pads = ALL[name].pads
    assert all(w > 0 and h > 0 for _, _, w, h in pads)
    assert not overlap(pads)


@pytest.mark.parametrize("name", ALL)
def test_the_body_lies_within_the_footprint_in_its_own_direction(name: str) -> None:
    package = ALL[name]
    assert package.body[0] <= package.size[0] + 1e-9
    assert package.body_height > 0
    assert min(package.size) > 0


@pytest.mark.parametrize("name", ALL)
def test_pads_reach_the_middle_of_the_footprint_evenly(name: str) -> None:
    """The CAD centre is the centre of the pads, across the part."""
    e = extents(ALL[name].pads)
    assert (e[:, 0].min() + e[:, 2].max()) / 2 == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", [n for n, p in ALL.items() if p.leads])
def test_every_lead_touches_its_pad(name: str) -> None:
    package = ALL[name]
    pads, leads = extents(package.pads), extents(package.leads)
    assert len(pads) == len(leads)
    for pad, lead in zip(pads, leads, strict=True):
        assert (np.minimum(pad[2:], lead[2:]) > np.maximum(pad[:2], lead[:2])).all()


@given(st.tuples(SIZE, SIZE), st.floats(0.1, 3.0))
def test_a_chip_has_two_pads_at_its_ends(size: tuple[float, float], height: float) -> None:
    package = chip("test", "R", size, height, Finish.RESISTOR)
    (left, _, wide, tall), (right, _, *_) = package.pads
    assert (left, right) == (-size[0] / 2, size[0] / 2)
    assert tall > size[1]
    assert package.size == (size[0] + wide, tall)
    assert package.small


@given(st.integers(2, 16).map(lambda n: 2 * n), st.floats(0.4, 1.3))
def test_a_small_outline_has_half_of_its_pins_on_each_side(pins: int, pitch: float) -> None:
    package = small_outline("SO", pins=pins, pitch=pitch, body=(4.0, pins * pitch / 2), height=1.5)
    sides = [np.sign(u) for u, *_ in package.pads]
    assert (len(package.pads), sides.count(1.0), sides.count(-1.0)) == (pins, pins // 2, pins // 2)
    rows = sorted({v for _, v, *_ in package.pads})
    assert np.allclose(np.diff(rows), pitch)
    assert not package.small
    assert not package.round


@given(st.integers(4, 20).map(lambda n: 4 * n))
def test_a_quad_flat_is_the_same_after_a_quarter_turn(pins: int) -> None:
    package = quad_flat("QFP", pins=pins, pitch=0.5, body=pins / 8 + 2.0, height=1.4)
    assert len(package.pads) == len(package.leads) == pins
    turned = {(round(-v, 6) + 0.0, round(u, 6) + 0.0) for u, v, *_ in package.pads}
    assert turned == {(round(u, 6) + 0.0, round(v, 6) + 0.0) for u, v, *_ in package.pads}


def test_a_transistor_has_three_leads() -> None:
    assert (len(sot23().pads), len(sot23().leads), sot23().prefix) == (3, 3, "Q")


@given(st.floats(3.0, 12.0), st.floats(3.0, 12.0))
def test_a_can_is_round(diameter: float, height: float) -> None:
    package = can_capacitor(diameter, height)
    assert package.round
    assert package.body == (diameter, diameter)
    assert package.body_height == height


@given(st.integers(1, 12), st.integers(1, 3))
def test_a_header_has_a_pin_every_tenth_of_an_inch(columns: int, rows: int) -> None:
    pads = header(columns, rows).pads
    assert len(pads) == columns * rows
    assert len({(round(u / 1.27), round(v / 1.27)) for u, v, *_ in pads}) == columns * rows
    assert not overlap(pads)


@given(st.floats(3.0, 20.0))
def test_a_socket_has_as_many_pads_as_fit(width: float) -> None:
    package = socket(width, 7.0, 3.0)
    assert len(package.pads) == max(int(width / 1.6), 2)
    e = extents(package.pads)
    assert e[:, 2].max() - e[:, 0].min() <= max(width, 2.0) + 1e-9


def test_only_chips_are_placed_in_groups() -> None:
    assert all(make().small for make in SMALL)
    assert not any(make().small for make in BIG)
    assert {make().prefix for make in SMALL} == {"R", "C"}


def test_packages_are_values() -> None:
    assert BIG[0]() == BIG[0]()
    assert isinstance(BIG[0](), Package)
