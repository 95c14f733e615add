"""Points of a clamped board are where they are stated, within their stated errors; what is not known is said."""

from __future__ import annotations

import numpy as np
import pytest

from tests.clamping.boards import FIDUCIALS, Clamp, board_type, filmed, request
from tests.clamping.draws import CENTERS, PARTS, ratios
from vaoi_station.clamping import CadPoint, Clamped, clamp
from vaoi_station.errors import InputError
from vaoi_station.model import Component, Status
from vaoi_station.model.board_type import Fiducial, PointTable

ALL = tuple(FIDUCIALS)


def places(answer: Clamped) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    return np.array([(p.x, p.y, p.z) for p in answer.points])


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_errors_are_as_large_as_stated(count: int) -> None:
    ratio = ratios(count, 60, 7)
    assert (ratio > 0.7).all(), ratio
    assert (ratio < 1.4).all(), ratio


def test_the_transform_is_that_of_least_squares_when_nothing_is_assumed() -> None:
    random, film = np.random.default_rng(3), filmed()
    noise = random.normal(0, 0.05, (5, 3))
    readings = Clamp(strain=(2e-3, 0.0, 0.0)).readings(*ALL, noise=noise)
    asked = request(readings, sigma=0.05, scale_ppm=1e5, shear_ppm=1e-3, bow=1e-6)
    matrix = np.array(clamp(film, asked).transforms[0].matrix)
    cad, read = np.array(list(FIDUCIALS.values())), np.array([(r.x, r.y) for r in readings])
    # Umeyama 1991: rotation and scale by the singular values of the covariance of both sets of points.
    a, b = cad - cad.mean(0), read - read.mean(0)
    left, values, right = np.linalg.svd(b.T @ a)
    sign = np.diag([1.0, np.linalg.det(left) * np.linalg.det(right)])
    linear = left @ sign @ right * (values @ sign.diagonal()) / (a**2).sum()
    expected = np.column_stack([linear, read.mean(0) - linear @ cad.mean(0)])
    assert matrix[:2] == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("side", ["top", "bottom"])
@pytest.mark.parametrize("unit", ["mm", "inch"])
def test_units_sides_and_axes(side: str, unit: str) -> None:
    """The tester sees the filmed side: CAD x, which is stated as seen from the top, runs to the left on the bottom."""
    mm = {"mm": 1.0, "inch": 25.4}[unit]
    film, there = filmed(board_type(side=side)), Clamp()
    flip = np.array([-1.0 if side == "bottom" else 1.0, 1.0])
    at = there(np.array(list(FIDUCIALS.values())) * flip)
    readings = [{"fiducial": n, "x": x / mm, "y": y / mm} for n, (x, y, _) in zip(FIDUCIALS, at.tolist(), strict=True)]
    answer = clamp(film, request(readings, unit=unit, sigma=0.01 / mm, points=PARTS))  # type: ignore[arg-type]
    assert answer.status is Status.OK, answer.reasons
    assert places(answer)[:, :2] * mm == pytest.approx(there(CENTERS * flip)[:, :2], abs=1e-4)


def test_a_single_reading_shifts_and_says_what_it_does_not_show() -> None:
    film, one = filmed(), Clamp().readings("F1")
    assert [r.code for r in clamp(film, request(one)).reasons] == ["turn-not-known"]
    answer = clamp(film, request(one, turn_deg=float(np.degrees(0.7)), points=("F1", "U8")))
    assert answer.status is Status.OK
    assert any("shift only" in text for text in answer.remarks)
    near, far = answer.points
    assert near.sigma_x < 0.02
    assert np.hypot(far.sigma_x, far.sigma_y) == pytest.approx(np.radians(0.5) * np.hypot(135, 75), rel=0.01)


def test_readings_on_a_line_leave_the_shape_across_it_to_what_is_stated() -> None:
    line = {"A": (10.0, 50.0), "B": (80.0, 50.0), "C": (150.0, 50.0)}
    film = filmed(board_type(fiducials=tuple(Fiducial(name=n, x=x, y=y, diameter=1.0) for n, (x, y) in line.items())))
    at = Clamp()(np.array(list(line.values()))).tolist()
    readings = [{"fiducial": n, "x": x, "y": y} for n, (x, y, _) in zip(line, at, strict=True)]
    answer = clamp(film, request(readings, turn_deg=float(np.degrees(0.7))))  # type: ignore[arg-type]
    assert any("show less than" in text for text in answer.remarks)
    assert answer.transforms[0].stretch.sigma_ppm > 50


def test_scale_and_shear_beyond_what_the_tester_states_are_named() -> None:
    answer = clamp(filmed(), request(Clamp(0.0, strain=(0.0, 0.0, 1.5e-3)).readings(*ALL), points=PARTS, bow=0.01))
    assert answer.status is Status.DEGRADED
    assert "shear" in answer.reasons[0].message
    assert "scale" not in answer.reasons[0].message
    true = Clamp(0.0, strain=(0.0, 0.0, 1.5e-3))(CENTERS)
    assert places(answer)[:, :2] == pytest.approx(true[:, :2], abs=3e-3), "points follow the readings"


def test_z_slopes_and_bow_follow_readings_of_z() -> None:
    places_of = {f"F{n}{m}": (20.0 + 60.0 * n, 10.0 + 40.0 * m) for n in range(3) for m in range(3)}
    marks = tuple(Fiducial(name=n, x=x, y=y, diameter=1.0) for n, (x, y) in places_of.items())
    there = Clamp(0.0, bow_mm=(0.4, 0.1, -0.2))
    at = there(np.array(list(places_of.values()))).tolist()
    readings = [{"fiducial": n, "x": x, "y": y, "z": z} for n, (x, y, z) in zip(places_of, at, strict=True)]
    cad = CadPoint(x=120.0, y=70.0)
    asked = request(readings, sigma_z=0.005, points=(cad,), turn_deg=0.0)  # type: ignore[arg-type]
    answer = clamp(filmed(board_type(fiducials=marks)), asked)
    assert answer.bend is not None
    assert answer.bend.bow_change == pytest.approx((0.4, 0.1, -0.2), abs=0.01)
    point, step = answer.points[0], np.array([(119.0, 70.0), (121.0, 70.0), (120.0, 69.0), (120.0, 71.0)])
    z = there(step)[:, 2]
    assert point.z == pytest.approx(there(np.array([[120.0, 70.0]]))[0, 2], abs=0.01)
    assert (point.slope_x, point.slope_y) == pytest.approx(((z[1] - z[0]) / 2, (z[3] - z[2]) / 2), abs=3e-4)


def test_without_z_heights_count_from_the_plane_of_the_fiducials() -> None:
    surface = {"lift_mm": 0.3, "tilt_mm": (0.2, 0.0), "about": (80.0, 50.0), "half_span": (80.0, 50.0)}
    answer = clamp(filmed(surface=surface), request(Clamp().readings(*ALL), points=("F1", "F3")))
    assert answer.z_from == "fiducials"
    assert [p.z for p in answer.points] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert any("no bow below" in text for text in answer.remarks)


def test_high_bodies_are_kept_out_with_their_errors_and_a_margin() -> None:
    low = Component(ref="R1", center=(40.0, 40.0), width=1.0, height=0.5, body_height=0.4)
    tall = Component(ref="C1", center=(120.0, 30.0), width=6.0, height=6.0, body_height=9.0)
    unknown = Component(ref="J1", center=(120.0, 60.0), width=6.0, height=6.0)
    film = filmed(board_type(components=(*board_type().components[:1], low, tall, unknown)))
    answer = clamp(film, request(Clamp(0.0).readings(*ALL), clearance=2.0, margin=0.5, turn_deg=0.0, bow=0.01))
    solids = {k.component: k for k in answer.keep_outs}
    assert [(k, solids[k].source) for k in solids] == [("U0", "measured"), ("C1", "board-type"), ("J1", "unknown")]
    assert solids["C1"].top is not None
    assert 9.5 < solids["C1"].top < 10.5
    assert solids["J1"].top is None
    width = np.ptp(np.array(solids["J1"].corners), axis=0)
    assert (width >= 7.0).all()
    assert (width < 7.3).all()


def test_the_top_of_a_body_reaches_over_the_middle_of_a_bow() -> None:
    shield = Component(ref="U0", center=(80.0, 50.0), width=120.0, height=70.0)
    bent = Clamp(0.0, bow_mm=(-1.0, 0.0, -1.0))
    answer = clamp(
        filmed(board_type(components=(shield,))), request(bent.readings(*ALL, z=True), clearance=2.0, sigma_z=0.01)
    )
    (solid,) = answer.keep_outs
    assert solid.top is not None
    assert solid.top > bent(np.array([shield.center]))[0, 2] + 3.0


def test_a_board_of_a_panel_and_a_part_with_local_fiducials_have_transforms_of_their_own() -> None:
    parts = tuple(
        Component(ref="U1", panel=p, center=(x, 50.0), width=4.0, height=4.0) for p, x in (("A", 40.0), ("B", 120.0))
    )
    marks = [Fiducial(name=n, x=x, y=y, diameter=1.0) for n, (x, y) in FIDUCIALS.items()]
    marks += [
        Fiducial(name=f"A{n}", x=x, y=y, diameter=1.0, panel="A")
        for n, (x, y) in enumerate(((20.0, 20.0), (60.0, 80.0)))
    ]
    marks += [Fiducial(name="L1", x=122.0, y=52.0, diameter=1.0, kind="local", components=("B/U1",))]
    film, there = filmed(board_type(components=parts, fiducials=tuple(marks))), Clamp(0.0)
    moved = {"A0": (0.05, 0.0), "A1": (0.05, 0.0), "L1": (0.0, 0.03)}
    readings = []
    for mark in marks:
        x, y, _ = there(np.array([(mark.x, mark.y)]))[0] + np.array([*moved.get(mark.name, (0.0, 0.0)), 0.0])
        readings.append({"fiducial": mark.name, "x": x, "y": y})
    answer = clamp(film, request(readings, points=("A/U1", "B/U1", "U1"[:0] or "F5"), turn_deg=0.0))  # type: ignore[arg-type]
    assert [(t.board, t.components) for t in answer.transforms] == [(None, ()), ("A", ()), (None, ("B/U1",))]
    off = places(answer)[:, :2] - there(np.array([(40.0, 50.0), (120.0, 50.0), FIDUCIALS["F5"]]))[:, :2]
    assert off == pytest.approx(np.array([(0.05, 0.0), (0.0, 0.03), (0.0, 0.0)]), abs=0.012)


def test_the_error_of_a_part_with_a_local_fiducial_has_that_of_the_whole_board() -> None:
    places_of = {"F1": (70.0, 50.0), "F2": (80.0, 50.0), "L1": (140.0, 80.0)}
    marks = [Fiducial(name=n, x=x, y=y, diameter=1.0) for n, (x, y) in places_of.items()]
    marks[2] = marks[2].model_copy(update={"kind": "local", "components": ("U8",)})
    parts = (Component(ref="U8", center=(155.0, 80.0), width=8.0, height=4.0),)
    film, there, random = (
        filmed(board_type(components=parts, fiducials=tuple(marks))),
        Clamp(),
        np.random.default_rng(1),
    )
    true, errors = there(np.array([(155.0, 80.0)]))[0], []
    for _ in range(80):
        at = there(np.array(list(places_of.values())))[:, :2] + random.normal(0, 0.05, (3, 2))
        readings = [{"fiducial": n, "x": x, "y": y} for n, (x, y) in zip(places_of, at.tolist(), strict=True)]
        p = clamp(film, request(readings, sigma=0.05, points=("U8",))).points[0]  # type: ignore[arg-type]
        errors.append(((p.x - true[0]) / p.sigma_x, (p.y - true[1]) / p.sigma_y))
    assert (np.sqrt(np.square(errors).mean(0)) < 1.4).all()


def test_a_fiducial_is_expected_where_it_was_filmed() -> None:
    film = filmed()
    off = {"name": "F1", "sightings": 9, "residual_px": (2.0, -1.0)}
    seen = filmed(quality={**film.result.quality, "fiducials": [off, *film.result.quality["fiducials"][1:]]})
    assert seen.places[0] - film.places[0] == pytest.approx(np.array((2.0, -1.0)) / 20.0)
    assert seen.places[1:] == pytest.approx(film.places[1:])


def test_a_change_of_bow_and_twist_is_said_in_words() -> None:
    grid = {f"G{n}{m}": (20.0 + 60.0 * n, 10.0 + 40.0 * m) for n in range(3) for m in range(3)}
    marks = tuple(Fiducial(name=n, x=x, y=y, diameter=1.0) for n, (x, y) in grid.items())
    for bow, words in (((0.4, 0.0, 0.0), ("+0.4", "along CAD x")), ((0.0, 0.2, 0.0), ("+0.2", "as a twist"))):
        at = Clamp(bow_mm=bow)(np.array(list(grid.values()))).tolist()
        readings = [{"fiducial": n, "x": x, "y": y, "z": z} for n, (x, y, z) in zip(grid, at, strict=True)]
        answer = clamp(filmed(board_type(fiducials=marks)), request(readings, sigma_z=0.005, turn_deg=np.degrees(0.7)))  # type: ignore[arg-type]
        (said,) = (text for text in answer.remarks if "as clamped less as filmed" in text)
        assert all(word in said for word in words)
        assert sum(of in said for of in ("along CAD x", "as a twist", "along CAD y")) == 1
    flat = clamp(filmed(), request(Clamp().readings("F1", "F2", z=True), sigma_z=0.005, turn_deg=np.degrees(0.7)))
    assert any("all of the tilt" in text for text in flat.remarks)


POINTS = PointTable(
    name=("U4-1", "U4-2", "U8-1", "VIA GND"), x=(78.0, 82.0, 140.0, 30.0), y=(50.0, 50.0, 80.0, 30.0),
    net=("GND", "3V3", "GND", "GND"),
)  # fmt: skip


def test_test_points_are_asked_for_by_net_by_component_and_all_each_once() -> None:
    film, readings = filmed(board_type(test_points=POINTS)), Clamp().readings(*ALL)

    def names(**asked: object) -> list[str]:
        return [p.name for p in clamp(film, request(readings, **asked)).points]

    assert names(nets=("3V3",), pads_of=("U4",)) == ["U4-2", "U4-1"]
    assert names(points=("U8-1", "U8"), nets=("GND",)) == ["U8-1", "U8", "U4-1", "VIA GND"]
    assert names(test_points=True) == list(POINTS.name)
    via = clamp(film, request(readings, test_points=True)).points[-1]
    assert via.net == "GND"
    assert (via.x, via.y) == pytest.approx(Clamp()(np.array([(30.0, 30.0)]))[0, :2], abs=1e-3)
    longer = board_type(
        components=(Component(ref="CONNECTOR1", center=(80.0, 50.0), width=8.0, height=4.0),),
        test_points=PointTable(name=("CONNEC-1",), x=(78.0,), y=(50.0,), net=("GND",)),
    )
    assert [p.name for p in clamp(filmed(longer), request(readings, pads_of=("CONNECTOR1",))).points] == ["CONNEC-1"]
    panel = [Component(ref=r, panel="1", center=(80.0, y), width=8.0, height=4.0)
             for y, r in enumerate(("CONNECTOR1", "CONVERTER1"))]  # fmt: skip
    longer = board_type(
        components=tuple(panel), test_points=PointTable(name=("1/CONNEC-1",), x=(78.0,), y=(50.0,), net=("GND",))
    )
    assert clamp(filmed(longer), request(readings, pads_of=("1/CONNECTOR1",))).points[0].name == "1/CONNEC-1"
    with pytest.raises(InputError, match="nets is 'VCC'"):
        names(nets=("VCC",))
    with pytest.raises(InputError, match="pads_of is 'U1'"):
        names(pads_of=("U1",))
    with pytest.raises(InputError, match="has no test points"):
        clamp(filmed(), request(readings, test_points=True))


def test_a_via_of_a_board_of_a_panel_moves_with_its_board() -> None:
    parts = tuple(
        Component(ref="U1", panel=p, center=(x, 50.0), width=4.0, height=4.0) for p, x in (("1", 40.0), ("2", 120.0))
    )
    table = PointTable(name=("1/VIA GND", "2/VIA GND", "2/U1-3"), x=(30.0, 110.0, 121.0), y=(30.0, 30.0, 50.0))
    matrix = filmed().matrix(None)
    moved = matrix.copy()
    moved[0, 2] += 0.2
    film = filmed(board_type(components=parts, test_points=table), board_matrices={"2": moved})
    first, second, pad = clamp(film, request(Clamp(0.0).readings(*ALL), test_points=True)).points
    assert second.x - first.x == pytest.approx(80.2, abs=0.01)
    assert pad.x - first.x == pytest.approx(91.2, abs=0.01)
