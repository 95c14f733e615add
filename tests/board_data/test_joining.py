from __future__ import annotations

import math
from dataclasses import replace

import pytest

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


def test_places_of_bodies_are_recognised() -> None:
    found = join_designs(places(of_body=True), bodies(), "top")
    u1 = found.parts[0]
    assert u1.origin == u1.center
    assert u1.origin == pytest.approx((7, 5))
    assert any("the second's centres of bodies" in note for note in found.notes)


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
        "1 parts have another rotation; the first file's is used: U3 (213°)",
        "1 parts have another rotation by quarter turns",
        "1 parts lie on different sides in both files: R1 (bottom, top)",
        "1 parts are in the first file only, without a body: X9",
        "2 parts are in the second file only; they were left out: FID1, R1",
    ):
        assert expected in text, expected
    parts = {p.ref: p for p in found.parts}
    assert parts["U1"].origin == pytest.approx((6, 5))
    # The placer's 0° of this package is another one; its body stays where the CAD system draws it.
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


def test_designators_that_repeat_on_a_side_are_left_out_and_named() -> None:
    twice = (Part("U1", "top", (1.0, 1.0), 0.0), Part("U2", "bottom", (1.0, 1.0), 0.0))
    found = join_designs(replace(places(), parts=(*places().parts, *twice)), bodies(), "top")
    assert [p.ref for p in found.parts] == ["U2", "U3", "U4", "R1"]
    assert "designators that occur more than once in the first file were left out: U1." in found.notes


def test_a_guess_of_the_second_file_does_not_replace_a_size_of_the_table() -> None:
    known = Box((-1.0, -1.0), (1.0, 1.0))
    first = tuple(replace(p, box=known, size_from="table") for p in places().parts)
    second = tuple(replace(p, size_from="guess") for p in bodies().parts)
    found = join_designs(replace(places(), parts=first), replace(bodies(), parts=second), "top")
    assert {(p.box, p.size_from, p.body_height) for p in found.parts} == {(known, "table", 1.5)}
