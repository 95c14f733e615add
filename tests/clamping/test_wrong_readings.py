"""Readings that are not of the fiducials that they name are found where that is possible, and named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from tests.clamping.boards import FIDUCIALS, Clamp, board_type, filmed, request
from vaoi_station.clamping import Clamped, Reading, clamp
from vaoi_station.errors import InputError, StateError
from vaoi_station.model import Component, Status
from vaoi_station.model.board_type import Fiducial

ALL = tuple(FIDUCIALS)


def codes(answer: Clamped) -> list[str]:
    return [reason.code for reason in answer.reasons]


def test_two_exchanged_readings_of_three_are_named() -> None:
    first, second, third = Clamp().readings("F1", "F2", "F4")
    swapped = (first.model_copy(update={"fiducial": "F2"}), second.model_copy(update={"fiducial": "F1"}), third)
    answer = clamp(filmed(), request(swapped))
    assert answer.status is Status.FAILED
    assert codes(answer) == ["fiducials-exchanged"]
    assert "F2 is F1, F1 is F2" in answer.reasons[0].message


def test_two_exchanged_readings_of_five_are_left_out() -> None:
    first, second, *rest = Clamp().readings(*ALL)
    swapped = (first.model_copy(update={"fiducial": "F2"}), second.model_copy(update={"fiducial": "F1"}), *rest)
    answer = clamp(filmed(), request(swapped))
    assert answer.status is Status.DEGRADED
    assert codes(answer) == ["reading-wrong", "reading-wrong"]
    assert "F2 is left out: it is at the place of F1" in answer.reasons[0].message


def test_one_wrong_reading_of_four_is_left_out_and_named() -> None:
    readings = Clamp().readings("F1", "F2", "F3") + (Clamp().readings("F5")[0].model_copy(update={"fiducial": "F4"}),)
    answer = clamp(filmed(), request(readings, points=("U4",)))
    assert answer.status is Status.DEGRADED
    assert "F4 is left out: it is at the place of F5" in answer.reasons[0].message
    x, y, _ = Clamp()(np.array([[80.0, 50.0]]))[0]
    assert (answer.points[0].x, answer.points[0].y) == pytest.approx((x, y), abs=1e-3)


def test_a_reading_that_is_off_by_ten_sigma_is_left_out() -> None:
    noise = np.zeros((5, 3))
    noise[4] = 0.08, 0.08, 0.0
    answer = clamp(filmed(), request(Clamp().readings(*ALL, noise=noise)))
    assert codes(answer) == ["reading-wrong"]
    assert [r.fiducial for r in answer.residuals if not r.used] == ["F5"]


def test_three_readings_that_disagree_count_as_a_change_of_shape_with_larger_errors() -> None:
    noise = np.zeros((3, 3))
    noise[2, 0] = 0.1
    stiff = {"scale_ppm": 5.0, "shear_ppm": 5.0, "bow": 0.001, "points": ("U8",)}
    good, bad = (
        clamp(filmed(), request(Clamp().readings("F1", "F2", "F3", noise=n), **stiff)) for n in (noise * 0, noise)
    )
    assert codes(bad) == ["shape-changed"]
    assert bad.points[0].sigma_x > 1.05 * good.points[0].sigma_x


def test_a_board_turned_by_180_degrees_is_noticed_by_the_turn_that_is_stated() -> None:
    answer = clamp(filmed(), request(Clamp().readings(*ALL), turn_deg=np.degrees(0.7) + 180))
    assert codes(answer) == ["board-turned"]


def test_a_symmetrical_pattern_has_no_answer_without_a_turn() -> None:
    corners = {"A": (10.0, 10.0), "B": (150.0, 10.0), "C": (150.0, 90.0), "D": (10.0, 90.0)}
    marks = tuple(Fiducial(name=name, x=x, y=y, diameter=1.0) for name, (x, y) in corners.items())
    at = Clamp()(np.array(list(corners.values()))).tolist()
    readings = tuple(Reading(fiducial=name, x=x, y=y) for name, (x, y, _) in zip(corners, at, strict=True))
    film = filmed(board_type(fiducials=marks))
    assert codes(clamp(film, request(readings))) == ["orientation-not-shown"]
    assert clamp(film, request(readings, turn_deg=np.degrees(0.7))).status is Status.OK
    turned = tuple(r.model_copy(update={"fiducial": n}) for r, n in zip(readings, "CDAB", strict=True))
    exchanged = clamp(film, request(turned, turn_deg=np.degrees(0.7)))
    assert codes(exchanged) == ["fiducials-exchanged"], "the stated turn shows it although the pattern does not"


def test_millimetres_that_are_sent_as_inches_are_named() -> None:
    answer = clamp(filmed(), request(Clamp().readings(*ALL), unit="inch", sigma=0.0004))
    assert codes(answer) == ["readings-other-unit"]
    assert "mm read as inch" in answer.reasons[0].message


def test_a_mirrored_side_is_named() -> None:
    answer = clamp(filmed(), request(Clamp().readings(*ALL), y_axis="down"))
    assert codes(answer) == ["readings-mirrored"]


def test_readings_of_another_board_are_refused_with_a_distance() -> None:
    stretched = tuple(r.model_copy(update={"x": r.x * 1.3}) for r in Clamp().readings(*ALL))
    answer = clamp(filmed(), request(stretched))
    assert codes(answer) == ["readings-disagree"]
    assert "apart, filmed" in answer.reasons[0].message
    assert not answer.points
    assert not answer.transforms


def test_a_wrong_z_is_noticed() -> None:
    first, *rest = Clamp().readings(*ALL, z=True)
    raised = (first.model_copy(update={"z": (first.z or 0.0) + 5.0}), *rest)
    answer = clamp(filmed(), request(raised, sigma_z=0.01))
    assert codes(answer) == ["readings-z-disagree"]


def test_z_of_a_reading_that_is_left_out_counts_as_little_as_its_place() -> None:
    first = Clamp().readings("F1", z=True)[0].model_copy(update={"x": 0.0})
    answer = clamp(filmed(), request((first, *Clamp().readings("F2", "F3", "F4", "F5")), sigma_z=0.01, points=("U4",)))
    assert codes(answer) == ["reading-wrong"]
    assert answer.z_from == "fiducials"


def test_readings_at_one_place_are_refused() -> None:
    same = tuple(r.model_copy(update={"x": 1.0, "y": 2.0}) for r in Clamp().readings(*ALL))
    assert codes(clamp(filmed(), request(same))) == ["readings-disagree"]


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"readings": Clamp().readings("F1", "F1")}, "read once"),
        ({"readings": (Reading(fiducial="F9", x=0.0, y=0.0),)}, "F1, F2"),
        ({"readings": Clamp().readings("F1", z=True)}, "sigma_z"),
        ({"points": ("R99",)}, "R99"),
        ({"sigma": 8.0, "unit": "inch"}, "unit is inch"),
        ({"readings": (Reading(fiducial="F1", x=213_410.0, y=0.0),)}, "unit is mm"),
    ],
)
def test_names_and_lengths_that_no_board_has_are_refused(fields: dict[str, object], field: str) -> None:
    known = {"readings": Clamp().readings("F1", "F2"), **fields}
    with pytest.raises(InputError, match=field):
        clamp(filmed(), request(**known))  # type: ignore[arg-type]


@pytest.mark.parametrize("fields", [{"sigma": 0.0}, {"sigma": float("nan")}, {"readings": ()}, {"margin": -1.0}])
def test_numbers_that_are_none_are_refused(fields: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        request(**{"readings": Clamp().readings("F1"), **fields})  # type: ignore[arg-type]


def test_a_run_without_a_cad_mapping_has_no_answer() -> None:
    with pytest.raises(StateError, match="no CAD mapping"):
        filmed(cad_matrix=None)


@pytest.mark.parametrize("status", [Status.DEGRADED, Status.FAILED])
def test_an_answer_is_no_better_than_the_verdict_of_the_run(status: Status) -> None:
    film = replace(filmed(), status=status, reasons=("links scatter",))
    answer = clamp(film, request(Clamp().readings(*ALL), points=("U1",)))
    assert answer.status is status
    assert "links scatter" in answer.reasons[0].message
    assert bool(answer.points) is (status is Status.DEGRADED)


def test_mil_that_are_sent_as_millimetres_are_named() -> None:
    near = Clamp(shift_mm=(0.0, 0.0)).readings(*ALL)
    readings = tuple(r.model_copy(update={"x": r.x / 0.0254, "y": r.y / 0.0254}) for r in near)
    answer = clamp(filmed(), request(readings))
    assert codes(answer) == ["readings-other-unit"]
    assert "mil read as mm" in answer.reasons[0].message


def test_one_of_four_readings_off_by_a_third_of_a_millimetre_is_left_out() -> None:
    for n, name in enumerate(ALL[:4]):
        readings = list(Clamp().readings(*ALL[:4]))
        readings[n] = readings[n].model_copy(update={"x": readings[n].x + 0.3})
        answer = clamp(filmed(), request(tuple(readings)))
        assert codes(answer) == ["reading-wrong"]
        assert [r.fiducial for r in answer.residuals if not r.used] == [name]


@pytest.mark.parametrize(
    ("off_mm", "angle_deg", "third"), [(1.5, 345.0, ("F1", "F2", "F3")), (0.15, 355.0, ("F1", "F5", "F3"))]
)
def test_one_wrong_reading_of_three_is_refused_and_not_outvoted_by_any_two_that_fit(
    off_mm: float, angle_deg: float, third: tuple[str, ...]
) -> None:
    noise, angle = np.zeros((3, 3)), np.radians(angle_deg)
    noise[2, :2] = off_mm * np.cos(angle), off_mm * np.sin(angle)
    readings = Clamp().readings(*third, noise=noise)
    answer = clamp(filmed(), request(readings, turn_deg=np.degrees(0.7), points=("U4",)))
    assert (answer.status, codes(answer)) == (Status.FAILED, ["readings-disagree"])
    assert not answer.points


PANEL = {"P1": (3.0, 3.0), "A1": (20.0, 20.0), "A2": (60.0, 80.0), "B1": (90.0, 20.0), "B2": (130.0, 80.0)}


@pytest.mark.parametrize("named", [("A1", "A2"), ("P1", "A1", "A2")])
def test_readings_of_the_next_board_of_a_panel_are_refused_if_anything_shows_it(named: tuple[str, ...]) -> None:
    marks, parts = list[Fiducial](), list[Component]()
    for name, (x, y) in PANEL.items():
        board = name[0] if name[0] in "AB" else None
        marks.append(Fiducial(name=name, x=x, y=y, diameter=1.0, panel=board))
        parts.append(Component(ref=f"U{name}", panel=board or "C", center=(x, y + 5), width=2.0, height=2.0))
    film, at = filmed(board_type(fiducials=tuple(marks), components=tuple(parts))), {"A1": "B1", "A2": "B2"}
    read = Clamp()(np.array([PANEL[at.get(name, name)] for name in named])).tolist()
    readings = tuple(Reading(fiducial=n, x=x, y=y) for n, (x, y, _) in zip(named, read, strict=True))
    answer = clamp(film, request(readings, turn_deg=np.degrees(0.7)))
    if "P1" in named:
        assert codes(answer) == ["fiducials-exchanged"]
    else:
        assert answer.status is Status.OK
        assert "fit as well if A1 is B1, A2 is B2" in " ".join(answer.remarks)


def test_an_error_across_the_line_of_two_readings_is_seen_by_the_turn_that_is_stated_with_its_sigma() -> None:
    first, second = Clamp(0.0).readings("F1", "F2")
    readings = (first, second.model_copy(update={"y": second.y + 0.3}))
    unseen = clamp(filmed(), request(readings, turn_deg=0.0))
    assert unseen.status is Status.OK
    assert any("across it turns the board unnoticed" in text for text in unseen.remarks)
    assert codes(clamp(filmed(), request(readings, turn_deg=0.0, turn_sigma_deg=0.01))) == ["board-turned"]
    good = clamp(filmed(), request((first, second), turn_deg=0.0, turn_sigma_deg=0.01))
    assert good.status is Status.OK
    assert not any("unnoticed" in text for text in good.remarks)


def test_two_hundred_readings_of_four_hundred_fiducials_are_matched_and_a_swap_is_named() -> None:
    random = np.random.default_rng(2)
    marks = tuple(
        Fiducial(name=f"M{n}", x=x, y=y, diameter=0.5)
        for n, (x, y) in enumerate((8.0 * i + dx, 5.0 * j + dy) for i in range(20) for j in range(20)
                                   for dx, dy in random.uniform(0, 3, (1, 2)))
    )  # fmt: skip
    chosen = random.permutation(400)[:200]
    read = Clamp()(np.array([(marks[n].x, marks[n].y) for n in chosen])).tolist()
    readings = [{"fiducial": f"M{n}", "x": x, "y": y} for n, (x, y, _) in zip(chosen, read, strict=True)]
    readings[3], readings[7] = (
        {**readings[7], "fiducial": f"M{chosen[3]}"},
        {**readings[3], "fiducial": f"M{chosen[7]}"},
    )
    film = filmed(board_type(fiducials=marks, components=(), outline=((0.0, 0.0), (170.0, 110.0))))
    answer = clamp(film, request(readings))  # type: ignore[arg-type]
    assert codes(answer) == ["reading-wrong", "reading-wrong"]
    assert f"M{chosen[3]} is left out: it is at the place of M{chosen[7]}" in answer.reasons[0].message


def test_two_fiducials_that_were_filmed_at_one_place_show_no_turn() -> None:
    film = filmed()
    seen = [{**entry} for entry in film.result.quality["fiducials"]]
    apart = (film.places[1] - film.places[0]) * film.px_per_mm
    seen[0]["residual_px"] = tuple(apart.tolist())
    alike = filmed(quality={**film.result.quality, "fiducials": seen})
    near = (Reading(fiducial="F1", x=0.0, y=0.0), Reading(fiducial="F2", x=30.0, y=0.0))
    answer = clamp(alike, request(near, sigma=9.0))
    assert answer.status is Status.FAILED
    assert not answer.points
