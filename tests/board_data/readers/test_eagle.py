from __future__ import annotations

from math import pi, sqrt
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.contours import area
from vaoi_station.board_data.design import Design, extent
from vaoi_station.board_data.readers.eagle import read_eagle
from vaoi_station.errors import InputError


def test_its_own_document_type_is_accepted_and_any_other_is_not() -> None:
    assert len(read_eagle(samples.EAGLE.encode(), Path("b.brd")).parts) == 4
    bomb = samples.EAGLE.replace('SYSTEM "eagle.dtd"', '[<!ENTITY a "aaa">]')
    with pytest.raises(InputError, match="declares a document type"):
        read_eagle(bomb.encode(), Path("b.brd"))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [("<board>", "<schematic>", "not valid XML"), ('x="10"', 'x="ten"', "element R1 x is 'ten', but must be a number")],
)
def test_wrong_files_are_refused(before: str, after: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_eagle(samples.EAGLE.replace(before, after).encode(), Path("b.brd"))
    with pytest.raises(InputError, match="has no <board>"):
        read_eagle(b"<eagle><drawing/></eagle>", Path("b.lbr"))


VARIANTS = '<variantdefs><variantdef name="LITE" current="yes"/><variantdef name="FULL"/></variantdefs>'


@pytest.mark.parametrize(
    ("variants", "attributes", "inside", "fitted", "value"),
    [
        ("", "", "", True, "10k"),
        ("", 'populate="no"', "", False, "10k"),
        ("", 'populate="yes"', "", True, "10k"),
        (VARIANTS, 'populate="no"', "", False, "10k"),
        (VARIANTS, "", '<variant name="LITE" populate="no"/>', False, "10k"),
        (VARIANTS, "", '<variant name="FULL" populate="no"/>', True, "10k"),
        (VARIANTS, 'populate="no"', '<variant name="LITE" populate="yes"/>', True, "10k"),
        (VARIANTS, "", '<variant name="LITE" value="4k7"/>', True, "4k7"),
        (VARIANTS, "", '<variant name="LITE" value=""/><variant name="FULL" value="1k"/>', True, "10k"),
        (VARIANTS.replace(' current="yes"', ""), "", '<variant name="LITE" populate="no"/>', True, "10k"),
        ("", "", '<attribute name="populate" value="NO"/>', False, "10k"),
        ("", "", '<attribute name="DNP" value="yes"/>', False, "10k"),
        ("", "", '<attribute name="DNP" value=""/>', True, "10k"),
        ("", 'value="DNP"', "", False, "DNP"),
    ],
)
def test_parts_are_fitted_as_the_current_variant_says(
    variants: str, attributes: str, inside: str, fitted: bool, value: str
) -> None:
    stated = attributes if "value=" in attributes else f'value="10k" {attributes}'
    element = f'<element name="R1" library="l" package="R" x="10" y="10" {stated}>{inside}</element>'
    text = samples.EAGLE.replace('<element name="R1" library="l" package="R" value="10k" x="10" y="10"/>', element)
    design = read_eagle(text.replace(" <elements>", f"{variants}<elements>").encode(), Path("b.brd"))
    (part,) = (part for part in design.parts if part.ref == "R1")
    assert (part.fitted, part.value) == (fitted, value)
    said = [note.values["variant"] for note in design.notes if note.code == "variant-read"]
    assert said == ([] if not variants else ["LITE" if "current" in variants else ""])


@pytest.mark.parametrize(
    ("rot", "side", "rotation"),
    [
        ("R90", "top", 90),
        ("SR90", "top", 90),
        ("MR90", "bottom", 270),
        ("MSR90", "bottom", 270),
        ("SMR22.5", "bottom", 337.5),
    ],
)
def test_spin_turns_no_part_and_mirroring_puts_it_below(rot: str, side: str, rotation: float) -> None:
    parts = read_eagle(samples.EAGLE.replace('rot="R90"', f'rot="{rot}"').encode(), Path("b.brd")).parts
    assert [(p.side, p.rotation) for p in parts if p.ref == "J1"] == [(side, rotation)]


@pytest.mark.parametrize(
    ("rot", "corner"),
    [("R0", (31, 22)), ("R90", (28, 21)), ("MR0", (29, 22)), ("MR90", (32, 21)), ("R180", (29, 18))],
)
def test_a_package_cuts_out_what_it_draws_on_layer_20(rot: str, corner: tuple[float, float]) -> None:
    """A slot from (0, 0) to (1, 2) of the package, which lies at (30, 20)."""
    slot = '<rectangle x1="0" y1="0" x2="1" y2="2" layer="20"/><pad name="1"'
    text = samples.EAGLE.replace('<pad name="1"', slot, 1).replace('rot="R90"', f'rot="{rot}"')
    design = read_eagle(text.replace('x="15" y="25" rot="MR270"', 'x="15" y="5" rot="R0"').encode(), Path("b.brd"))
    assert any((round(x, 6), round(y, 6)) == corner for contour in design.cut_outs for x, y in contour)
    assert len(design.cut_outs) == 2


PAD = '<smd name="1" x="0" y="0" dx="1" dy="1" layer="1"/>'


def package(width: int) -> str:
    return f'<package name="P">{PAD}<rectangle x1="0" y1="0" x2="{width}" y2="2" layer="51"/></package>'


def library(width: int, urn: str = "", name: str = "lib") -> str:
    stated = f' urn="{urn}"' if urn else ""
    return f'<library name="{name}"{stated}><packages>{package(width)}</packages></library>'


def read(libraries: str, elements: str) -> Design:
    board = f"<board><libraries>{libraries}</libraries><elements>{elements}</elements></board>"
    return read_eagle(f'<eagle version="9.6.2"><drawing>{board}</drawing></eagle>'.encode(), Path("b.brd"))


def element(urn: str = "", **more: str) -> str:
    stated = {"name": "U1", "library": "lib", "package": "P", "value": "", "x": "5", "y": "6"} | more
    stated |= {"library_urn": urn} if urn else {}
    return "<element " + " ".join(f'{key}="{value}"' for key, value in stated.items()) + "/>"


@pytest.mark.parametrize(
    ("libraries", "urn", "width"),
    [
        (library(3, "urn:1") + library(7, "urn:2"), "urn:1", 3),
        (library(3, "urn:1") + library(7, "urn:2"), "urn:2", 7),
        (library(3) + library(7, "urn:2"), "", 3),
        (library(3, "urn:1") + library(7), "", 7),
        (library(3, "urn:1"), "", 3),
        (library(3), "urn:1", 3),
        (library(3, "urn:1"), "urn:other", 3),
        (library(3, "urn:1") + library(3, "urn:2"), "", 3),
        (library(3, "urn:1", name="LIB") + library(7, "urn:1", name="other"), "urn:1", 3),
    ],
)
def test_the_library_of_an_element_is_that_of_its_urn_else_the_only_one(libraries: str, urn: str, width: int) -> None:
    design = read(libraries, element(urn))
    (part,) = design.parts
    assert part.box is not None
    assert part.box.size == pytest.approx((width, 2))
    assert not design.notes


@pytest.mark.parametrize("urn", ["", "urn:other"])
def test_a_package_that_may_be_one_of_several_is_said_and_not_taken(urn: str) -> None:
    design = read(library(3, "urn:1") + library(7, "urn:2"), element(urn) + element("urn:2", name="U2"))
    assert [part.box is not None for part in design.parts] == [False, True]
    (note,) = design.notes
    assert (note.code, note.values["names"]) == ("packages-ambiguous", "P of lib (U1)")


SQUARE = '<vertex x="0" y="0"/><vertex x="40" y="0"{}/><vertex x="40" y="40"/><vertex x="0" y="40"/>'
CURVED = SQUARE.format(' curve="180"')


@pytest.mark.parametrize(
    ("drawing", "expected", "low", "high"),
    [
        (f'<polygon layer="20">{SQUARE.format("")}</polygon>', 1600, (0, 0), (40, 40)),
        (f'<polygon layer="20">{CURVED}</polygon>', 1600 + 200 * pi, (0, 0), (60, 40)),
        (
            f'<polygonshape layer="20"><polygonoutlinesegments>{CURVED}</polygonoutlinesegments></polygonshape>',
            1600 + 200 * pi,
            (0, 0),
            (60, 40),
        ),
        ('<rectangle x1="0" y1="0" x2="60" y2="40" layer="20" rot="R90"/>', 2400, (10, -10), (50, 50)),
        (
            '<rectangle x1="-20" y1="-20" x2="20" y2="20" layer="20" rot="R45"/>',
            1600,
            (-20 * sqrt(2), -20 * sqrt(2)),
            (20 * sqrt(2), 20 * sqrt(2)),
        ),
    ],
)
def test_polygons_with_curves_and_rotated_rectangles_are_outlines(
    drawing: str, expected: float, low: tuple[float, float], high: tuple[float, float]
) -> None:
    board = f"<board><plain>{drawing}</plain></board>"
    design = read_eagle(f'<eagle version="9.7.0"><drawing>{board}</drawing></eagle>'.encode(), Path("b.brd"))
    assert area(design.outline) == pytest.approx(expected, rel=1e-3)
    for found, limit in zip(extent(design.outline), (low, high), strict=True):
        assert found == pytest.approx(limit, abs=0.02)
    assert not design.notes
