"""Copper keeps off pads, fiducials, holes and other copper."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from vaoi_station.simulation.board.layout import Part, mounting_holes, place_parts
from vaoi_station.simulation.board.routing import Copper, route
from vaoi_station.simulation.scenario import BoardSection

SECTION = BoardSection(width_mm=50.0, length_mm=46.0, density=2.5)
CELL_MM = 1 / 8


@pytest.fixture(scope="module")
def parts() -> tuple[Part, ...]:
    return place_parts(SECTION)


@pytest.fixture(scope="module")
def copper(parts: tuple[Part, ...]) -> Copper:
    return route(SECTION, parts)


def points(trace: np.ndarray) -> np.ndarray:
    """Points along a polyline, (k, 2), closer than a cell."""
    steps = [np.linspace(a, b, int(np.hypot(*(b - a)) / CELL_MM) * 2 + 2) for a, b in pairwise(trace)]
    return np.vstack(steps)


def test_copper_stays_on_the_board(copper: Copper) -> None:
    size = (SECTION.width_mm, SECTION.length_mm)
    for trace in copper.traces:
        assert (trace > 0.7).all()
        assert (trace < np.array(size) - 0.7).all()
    vias = np.array(copper.vias)
    assert (vias > 0).all()
    assert (vias < size).all()


def test_traces_do_not_cross_pads_of_other_parts(copper: Copper, parts: tuple[Part, ...]) -> None:
    """Beyond the pad at which a trace starts."""
    for trace in copper.traces:
        p = points(trace)
        p = p[np.hypot(*(p - trace[0]).T) > 2.5]
        for part in parts:
            a = np.radians(part.turned_deg)
            back = np.array([[np.cos(a), np.sin(a)], [-np.sin(a), np.cos(a)]])
            local = (p - part.place) @ back
            for u, v, w, h in part.package.pads:
                inside = (np.abs(local - (u, v)) < (w / 2 - CELL_MM, h / 2 - CELL_MM)).all(1)
                assert not inside.any()


def test_fiducials_and_mounting_holes_stay_free(copper: Copper) -> None:
    free = [((mark.x_mm, mark.y_mm), 1.5 * mark.diameter_mm) for mark in SECTION.marks]
    free += [(hole, 2.6) for hole in mounting_holes(SECTION)]
    assert len(free) == 5
    for center, radius in free:
        for trace in copper.traces:
            assert np.hypot(*(points(trace) - center).T).min() > radius - 2 * CELL_MM
        assert np.hypot(*(np.array(copper.vias) - center).T).min() > radius - 2 * CELL_MM


def test_traces_do_not_cross_each_other(copper: Copper) -> None:
    """Half a trace's clearance apart, beyond the pads at which they start."""
    routed = [points(trace) for trace in copper.traces]
    for n, p in enumerate(routed):
        far = p[np.hypot(*(p - p[0]).T) > 2.5]
        for q in routed[:n]:
            if len(far):
                distances = np.hypot(far[:, None, 0] - q[None, :, 0], far[:, None, 1] - q[None, :, 1])
                assert distances.min() > 0.1
