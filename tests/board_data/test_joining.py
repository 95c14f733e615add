from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.board_data.conversion import to_board_type
from vaoi_station.board_data.design import XY, Box, Design, Part, normalised, rotated
from vaoi_station.board_data.joining import join_designs
from vaoi_station.errors import InputError

BODY = Box((0.0, -1.0), (4.0, 1.0))
PLACES: dict[str, XY] = {"U1": (5, 5), "U2": (20, 8), "U3": (33, 30), "U4": (8, 27), "R1": (26, 19)}


def bodies(**change: object) -> Design:
    parts = [Part(ref, "top", at, 90.0 * n, box=BODY, body_height=1.5) for n, (ref, at) in enumerate(PLACES.items())]
    parts.append(
        Part("FID1", "top", (2.0, 2.0), 0.0, is_mark=True, mark_diameter=1.2, box=Box((-0.6, -0.6), (0.6, 0.6)))
    )
    outline = ((0.0, 0.0), (40.0, 0.0), (40.0, 35.0), (0.0, 35.0))
    return replace(Design("cad", "kicad", tuple(parts), outline), **change)  # type: ignore[arg-type]


def places(degrees: float = 0.0, shift: XY = (0.0, 0.0), factor: float = 1.0, of_body: bool = False) -> Design:
    parts = []
    for part in bodies().parts[:-1]:
        x, y = rotated(part.center if of_body else part.origin, degrees)
        at = ((x + shift[0]) * factor, (y + shift[1]) * factor)
        parts.append(Part(part.ref, "top", at, normalised(part.rotation + degrees), size_from="guess"))
    return Design("placer", "centroid", tuple(parts))


@pytest.mark.parametrize("degrees", [0.0, 90.0, 180.0, 30.0])
def test_places_stay_and_bodies_outline_and_marks_follow(degrees: float) -> None:
    found = join_designs(places(degrees, (3.0, -7.0)), bodies(), "top")
    note = next(n for n in found.notes if n.startswith("joined"))
    assert f"origins, rotated by {degrees:g}° and shifted by (3.000, -7.000) mm; 5 agree within 0 µm" in note
    u2 = next(p for p in found.parts if p.ref == "U2")
    assert u2.box is not None
    assert (u2.box.size, u2.size_from, u2.body_height) == ((4, 2), "file", 1.5)
    x, y = rotated((40.0, 35.0), degrees)
    assert math.dist(found.outline[2], (x + 3, y - 7)) < 1e-9
    board, _ = to_board_type(found, "top")
    assert [(f.name, f.diameter, f.found_by) for f in board.fiducials] == [("FID1", 1.2, "package")]


def test_a_side_that_the_placer_mirrors_is_mirrored_back() -> None:
    mirrored = [
        replace(p, origin=(-p.origin[0], p.origin[1]), rotation=normalised(-p.rotation)) for p in places().parts
    ]
    found = join_designs(replace(places(), parts=tuple(mirrored)), bodies(), "top")
    assert {p.ref: p.origin for p in found.parts} == PLACES
    assert [p.rotation for p in found.parts] == [p.rotation for p in places().parts]
    assert any("mirrored in x" in note for note in found.notes)


def test_conflicts_are_listed_and_the_places_of_the_first_file_are_kept() -> None:
    u1, u2, u3, u4, r1 = places().parts
    first = (replace(u1, origin=(6.0, 5.0)), replace(u2, rotation=180.0), replace(u3, rotation=33.0),
             u4, replace(r1, side="bottom"), Part("X9", "top", (1, 1), 0.0))  # fmt: skip
    found = join_designs(replace(places(), parts=first), bodies(), "top")
    text = "\n".join(found.notes)
    for expected in (
        "1 parts are at another place in the second file; the first file's is used: U1 (1.00 mm)",
        "2 parts have another rotation by their pads in the second file; that is used: U2 (90°), U3 (213°)",
        "1 parts lie on different sides in both files: R1 (bottom, top)",
        "1 parts are in the first file only, without a body: X9",
        "2 parts are in the second file only; they were left out: FID1, R1",
    ):
        assert expected in text, expected
    parts = {p.ref: p for p in found.parts}
    assert parts["U1"].origin == pytest.approx((6, 5))
    assert [parts[ref].rotation for ref in ("U1", "U2", "U3", "U4")] == [0, 90, 180, 270]
    assert parts["U2"].center == pytest.approx(bodies().parts[1].center)


@pytest.mark.parametrize(
    ("first", "message"),
    [
        (places(factor=25.4), r"'25.4 times that in the second', but must be equal in both; check --units"),
        (replace(places(), parts=places().parts[:2]), "have 2 designators of the top in common, needed are 3"),
        (
            replace(places(), parts=tuple(replace(p, origin=(n * n, 7.0 * n)) for n, p in enumerate(places().parts))),
            "do not fit: only 1 of 5 common parts are at the same place",
        ),
    ],
)
def test_files_that_do_not_fit_are_refused(first: Design, message: str) -> None:
    with pytest.raises(InputError, match=message):
        join_designs(first, bodies(), "top")


def test_of_two_parts_of_the_second_file_with_one_designator_the_fitted_one_gives_the_body() -> None:
    other = Part("U1", "top", (9.0, 9.0), 0.0, box=Box((-9.0, -9.0), (9.0, 9.0)), fitted=False)
    found = join_designs(places(), bodies(parts=(other, *bodies().parts)), "top")
    u1 = next(p for p in found.parts if p.ref == "U1")
    assert (u1.box, u1.size_from, u1.fitted) == (BODY, "file", True)
    codes = {note.code for note in found.notes}
    assert "parts-alternative" in codes
    assert "parts-without-body" not in codes


ANGLE_RULES: dict[str, Callable[[float], float]] = {
    "counter-clockwise": lambda r: r,
    "clockwise": lambda r: -r,
    "clockwise from 180°": lambda r: 180 - r,
    "counter-clockwise from 180°": lambda r: 180 + r,
}
"""What the placer writes of an angle; each is its own inverse, but for whole turns."""


def many(count: int = 20) -> Design:
    """Return a board with parts of five packages at all multiples of 45°, with bodies beside their origin."""
    parts = [
        Part(f"U{n}", "bottom", (7.0 * n, 1.0 * (n * n % 23)), normalised(45.0 * n), f"P{n % 5}", box=BODY)
        for n in range(count)
    ]
    return Design("cad", "kicad", tuple(parts))


def placer(
    rule: Callable[[float], float], offsets: Mapping[str, float] = MappingProxyType({}), *, mirrored: bool = False
) -> Design:
    parts = []
    for part in many().parts:
        x, y = part.origin
        angle = normalised(rule(part.rotation + offsets.get(part.package, 0.0)))
        parts.append(Part(part.ref, "bottom", (-x if mirrored else x, y), angle, size_from="guess"))
    return Design("placer", "centroid", tuple(parts))


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("offsets", [{}, {"P1": 90.0}, {"P0": 180.0, "P2": 270.0}])
@pytest.mark.parametrize("name", ANGLE_RULES)
def test_what_angles_of_a_side_mean_is_found_by_all_parts(name: str, offsets: dict[str, float], mirrored: bool) -> None:
    found = join_designs(placer(ANGLE_RULES[name], offsets, mirrored=mirrored), many(), "bottom")
    (note,) = [n for n in found.notes if n.code == "angles-joined"]
    assert (note.values["rule"], note.values["fit"], note.values["count"]) == (name, "20", "20")
    for part, cad in zip(found.parts, many().parts, strict=True):
        assert part.center == pytest.approx(cad.center), part.ref
        assert part.rotation == normalised(cad.rotation + offsets.get(cad.package, 0.0))
    assert [n.code for n in found.notes if "differ" in n.code] == (["quarter-turns-differ"] if offsets else [])


@pytest.mark.parametrize("wrong", [45.0, 90.0, 180.0, 7.0, 270.5])
@pytest.mark.parametrize("name", ANGLE_RULES)
def test_a_part_with_a_wrong_angle_gets_that_of_its_pads_and_is_named(name: str, wrong: float) -> None:
    first = placer(ANGLE_RULES[name])
    parts = tuple(replace(p, rotation=p.rotation + wrong) if p.ref == "U5" else p for p in first.parts)
    found = join_designs(replace(first, parts=parts), many(), "bottom")
    for part, cad in zip(found.parts, many().parts, strict=True):
        assert part.rotation == cad.rotation
        assert part.center == pytest.approx(cad.center)
    (note,) = [n for n in found.notes if n.code == "rotations-differ"]
    assert note.values["names"].startswith("U5 (")


@settings(max_examples=40, deadline=None)
@given(
    name=st.sampled_from(sorted(ANGLE_RULES)),
    degrees=st.sampled_from([0.0, 90.0, 180.0, 270.0]),
    angles=st.lists(st.floats(0, 360), min_size=8, max_size=20),
    wrong=st.sets(st.integers(0, 19), max_size=2),
)
def test_bodies_are_right_by_any_rule_at_any_angles(
    name: str, degrees: float, angles: list[float], wrong: set[int]
) -> None:
    cad = [
        Part(f"U{n}", "bottom", (7.0 * n, float(n * n % 23)), normalised(angle), f"P{n % 3}", box=BODY)
        for n, angle in enumerate(angles)
    ]
    first = [
        Part(p.ref, "bottom", rotated(p.origin, degrees), ANGLE_RULES[name](p.rotation + degrees) + 33 * (n in wrong))
        for n, p in enumerate(cad)
    ]
    found = join_designs(Design("placer", "centroid", tuple(first)), Design("cad", "odb", tuple(cad)), "bottom")
    for part, of in zip(found.parts, cad, strict=True):
        assert part.center == pytest.approx(rotated(of.center, degrees), abs=5e-3)
