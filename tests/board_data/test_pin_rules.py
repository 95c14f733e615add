from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.board_data.design import XY, Box, Part, Side, normalised, rotated
from vaoi_station.board_data.pin_rules import RULES, DrawnPart, Pin, Rule, placed_parts
from vaoi_station.model.reason import Note

SOT: tuple[XY, ...] = ((-0.95, -1.1), (0.95, -1.1), (0.0, 1.1))
CHIP: tuple[XY, ...] = ((-0.9, 0.0), (0.9, 0.0))
HEADER: tuple[XY, ...] = ((0.0, 0.0), (7.0, 0.0))
BODY = Box((0.0, -2.0), (8.0, 2.0))
SPEC = {"top": Rule(mirrored=False, sign=-1), "bottom": Rule(mirrored=True, sign=1)}


def usual(side: Side, _word: str) -> Rule:
    return SPEC[side]


def on_board(point: XY, rule: Rule, degrees: float, origin: XY) -> XY:
    """Return where a point of a package lies, written without the code under test."""
    x, y = (-point[0] if rule.mirrored else point[0]), point[1]
    dx, dy = rotated((x, y), rule.sign * degrees + rule.offset)
    return origin[0] + dx, origin[1] + dy


def drawn(
    ref: str,
    rule: Rule,
    degrees: float,
    pins: tuple[XY, ...] = SOT,
    *,
    side: Side = "bottom",
    stated: float | None = None,
) -> DrawnPart:
    """Return a part whose pins lie by a rule at an angle; the file may state another angle."""
    origin = (10.0, 20.0)
    part = Part(ref, side, origin, degrees if stated is None else stated, box=BODY)
    return DrawnPart(part, (tuple(Pin(p, (on_board(p, rule, degrees, origin),)) for p in pins),))


def codes(notes: list[Note]) -> list[str]:
    return [note.code for note in notes]


@pytest.mark.parametrize("side", ["top", "bottom"])
@pytest.mark.parametrize("rule", RULES)
def test_every_rule_is_found_on_either_side_also_for_bodies_beside_their_origin(rule: Rule, side: Side) -> None:
    parts, notes = placed_parts([drawn(f"Q{a}", rule, a, side=side) for a in (0, 45, 90, 270)], usual)
    for part, degrees in zip(parts, (0, 45, 90, 270), strict=True):
        assert part.rotation == normalised(rule.sign * degrees + rule.offset)
        assert part.center == pytest.approx(on_board((4.0, 0.0), rule, degrees, (10, 20)))
    (note,) = notes
    assert note.code == "rotation-by-pins"
    assert (note.values["fit"], note.values["pins"], note.values["rule"]) == ("12", "12", str(rule))


@settings(max_examples=60, deadline=None)
@given(
    rule=st.sampled_from(RULES),
    side=st.sampled_from(["top", "bottom"]),
    parts=st.lists(
        st.tuples(
            st.floats(0, 360),
            st.lists(st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=6),
            st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
        ),
        min_size=1,
        max_size=8,
    ),
)
def test_the_decided_rule_puts_all_pins_and_bodies_right(
    rule: Rule, side: Side, parts: list[tuple[float, list[XY], XY]]
) -> None:
    """A part with an asymmetrical package is among them, so that one rule is left."""
    origin = (3.0, -4.0)
    made = [drawn("Q1", rule, 20.0, side=side)]
    for n, (degrees, pins, (x, y)) in enumerate(parts):
        part = Part(f"U{n}", side, origin, degrees, box=Box((x, y), (x + 3, y + 2)))
        made.append(DrawnPart(part, (tuple(Pin(p, (on_board(p, rule, degrees, origin),)) for p in pins),)))
    found, notes = placed_parts(made, usual)
    assert codes(notes) == ["rotation-by-pins"]
    for before, after in zip(made, found, strict=True):
        assert before.part.box is not None
        center = on_board(before.part.box.center, rule, before.part.rotation, before.part.origin)
        assert after.center == pytest.approx(center, abs=1e-4)


@pytest.mark.parametrize("side", ["top", "bottom"])
@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 270.0])
def test_symmetrical_pins_leave_the_usual_rule(side: Side, degrees: float) -> None:
    """Two pins along x do not show in which axis the package is mirrored."""
    rule = SPEC[side]
    (part,), (note,) = placed_parts([drawn("R1", rule, degrees, CHIP, side=side)], usual)
    assert part.rotation == rule.rotation(degrees)
    assert note.values["rule"] == str(rule)
    assert int(note.values["rivals"]) >= 1
    assert note.endswith("rules fit as well.")


@pytest.mark.parametrize("stated", [0.0, 45.0, 180.0, 271.5])
def test_a_part_with_a_wrong_angle_gets_that_of_its_pins_and_is_named(stated: float) -> None:
    right = [drawn(f"Q{n}", SPEC["bottom"], 90.0 * n) for n in range(4)]
    found, notes = placed_parts([*right, drawn("U9", SPEC["bottom"], 90.0, HEADER, stated=stated)], usual)
    assert found[-1].rotation == 90
    assert found[-1].center == pytest.approx((10, 16))
    assert codes(notes) == ["rotation-by-pins", "angles-by-pins"]
    assert f"U9 (90° instead of {stated:g}°" in notes[1]


def test_a_part_whose_package_is_drawn_from_the_other_side_is_put_right() -> None:
    right = [drawn(f"Q{n}", SPEC["bottom"], 90.0 * n) for n in range(4)]
    found, notes = placed_parts([*right, drawn("Q9", Rule(mirrored=False, sign=1), 45.0)], usual)
    assert found[-1].center == pytest.approx(on_board((4.0, 0.0), Rule(False, 1), 45.0, (10, 20)))
    assert "Q9" in notes[1].values["names"]


@pytest.mark.parametrize(
    "places", [((10.0, 21.0), (14.0, 20.0)), ((0.0, 0.0), (0.0, 0.0)), ((10.0, 20.0), (17.5, 20.0))]
)
def test_a_part_whose_pins_fit_no_angle_is_named_and_follows_its_side(places: tuple[XY, XY]) -> None:
    right = [drawn(f"Q{n}", SPEC["bottom"], 90.0 * n) for n in range(4)]
    bad = replace(drawn("U9", SPEC["bottom"], 90.0), readings=((*map(Pin, SOT[:2], ((p,) for p in places)),),))
    found, notes = placed_parts([*right, bad], usual)
    assert found[-1].rotation == 90
    assert notes[1].code == "pins-unfit"
    assert notes[1].values["names"] == "U9"


def test_the_reading_of_pin_numbers_is_found_for_each_side() -> None:
    part = drawn("Q1", SPEC["bottom"], 90.0)
    wrong = tuple(Pin(p.drawn, q.places) for p, q in zip(part.readings[0], part.readings[0][::-1], strict=True))
    (found,), (note,) = placed_parts([replace(part, readings=(wrong, part.readings[0]))], usual)
    assert (found.rotation, note.values["fit"]) == (90.0, "3")


def beside_their_origin(sizes: tuple[float, ...], *, mirrored: bool) -> list[DrawnPart]:
    """Return parts with pins at the right end of bodies, of as many packages as sizes; bodies may be mirrored."""
    parts = []
    for n, size in enumerate(sizes):
        body = Box((0.0, -size), (8.0, size))
        part = drawn(f"J{n}", SPEC["bottom"], 90.0)
        part = replace(part, part=replace(part.part, box=body.mirrored() if mirrored else body))
        parts.append(replace(part, pads=Box((5.0, -size / 2), (7.5, size / 2))))
    return parts


def shifted(part: DrawnPart, by: XY) -> DrawnPart:
    """Return a part whose pins lie beside their places."""
    (pins,) = part.readings
    moved = tuple(pin._replace(places=tuple((x + by[0], y + by[1]) for x, y in pin.places)) for pin in pins)
    return replace(part, readings=(moved,))


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("by", [(100.0, 0.0), (-0.5, 2.54)])
def test_pins_that_are_all_shifted_alike_have_another_datum_and_move_no_body(rule: Rule, by: XY) -> None:
    parts = [drawn(f"Q{n}", rule, 30.0 * n) for n in range(3)] + [drawn("J1", rule, 45.0, HEADER)]
    expected, _ = placed_parts(parts, usual)
    found, notes = placed_parts([shifted(part, by) for part in parts], usual)
    assert found == expected
    assert codes(notes) == ["pins-of-other-datum", "rotation-by-pins"]
    assert notes[0].values["shift_mm"] == f"{by[0]:.3f}, {by[1]:.3f}"
    assert (notes[1].values["fit"], notes[1].values["rule"]) == ("10", str(rule))


@pytest.mark.parametrize("pins", [(), CHIP], ids=["no pins", "symmetrical pins"])
def test_parts_whose_pins_show_no_rule_follow_that_of_other_parts_of_their_side(pins: tuple[XY, ...]) -> None:
    """At 0° two pins along x leave four rules."""
    rule = Rule(False, -1)
    proven = [replace(drawn(f"Q{n}", rule, 30.0 * n), word="M") for n in range(3)]
    (*_, found), notes = placed_parts([*proven, drawn("J1", rule, 0.0, pins), drawn("J2", rule, 20.0, ())], usual)
    assert found.center == pytest.approx(on_board((4.0, 0.0), rule, 20.0, (10, 20)))
    assert set(codes(notes)) == {"rotation-by-pins", "rotation-by-pins" if pins else "rotation-by-others"}
    assert {note.values["rule"] for note in notes} == {str(rule)}


@pytest.mark.parametrize("mirrored", [False, True])
def test_pins_of_several_packages_show_from_which_side_outlines_are_drawn(mirrored: bool) -> None:
    """Pins lie within their outline, here at its right end."""
    found, notes = placed_parts(beside_their_origin((2.0, 3.0, 4.0), mirrored=mirrored), usual)
    assert [part.center for part in found] == [pytest.approx((10, 16))] * 3
    assert codes(notes) == ["rotation-by-pins", *["outlines-by-pins"] * mirrored]
    assert not mirrored or notes[1].values == {"count": "3", "side": "bottom"}


@pytest.mark.parametrize(("against", "usual_ones"), [((2.0,) * 5, ()), ((2.0, 3.0), ()), ((2.0, 3.0, 4.0), (5.0,))])
def test_few_packages_with_bodies_beside_their_pins_turn_no_outlines_over(
    against: tuple[float, ...], usual_ones: tuple[float, ...]
) -> None:
    """An edge connector has its body beside its pins, however often it is placed."""
    parts = beside_their_origin(against, mirrored=True) + beside_their_origin(usual_ones, mirrored=False)
    found, notes = placed_parts(parts, usual)
    assert [part.center for part in found] == [pytest.approx((10, 24))] * len(against) + [
        pytest.approx((10, 16))
    ] * len(usual_ones)
    assert codes(notes) == ["rotation-by-pins"]
