from __future__ import annotations

from math import pi
from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.contours import area
from vaoi_station.board_data.readers.kicad import read_kicad

PATH = Path("b.kicad_pcb")


def test_texts_values_and_footprints_that_are_not_placed() -> None:
    design = read_kicad(samples.KICAD.encode(), PATH)
    assert design.name == "sample"
    assert {p.ref: p.value for p in design.parts}["R1"] == '10k "1%"'
    assert design.notes == ("1 footprints are not for placement, or have no designator; they were left out.",)


def test_the_courtyard_without_its_margin_and_the_pads_replace_a_missing_drawing() -> None:
    parts = {p.ref: p for p in read_kicad(samples.KICAD.encode(), PATH).parts}
    boxes = {ref: parts[ref].box for ref in ("J1", "C1")}
    assert boxes["J1"] is not None
    assert boxes["C1"] is not None
    assert boxes["J1"].size == pytest.approx((7.5, 3.5))
    assert boxes["C1"].size == pytest.approx((1.5, 0.6))


def test_version_5_has_modules_texts_and_arcs_by_angle() -> None:
    old = """(kicad_pcb (version 20171130)
      (module L:R (layer B.Cu) (at 10 20 180) (fp_text reference R9 (at 0 0)) (fp_text value 1k (at 0 0))
        (fp_circle (center 0 0) (end 2 0) (layer B.Fab)))
      (gr_arc (start 0 0) (end 10 0) (angle 90) (layer Edge.Cuts))
      (gr_line (start 0 10) (end 0 0) (layer Edge.Cuts)) (gr_line (start 0 0) (end 10 0) (layer Edge.Cuts)))"""
    design = read_kicad(old.encode(), PATH)
    (part,) = design.parts
    assert (part.ref, part.side, part.rotation, part.value, part.origin) == ("R9", "bottom", 180, "1k", (10, -20))
    assert part.box is not None
    assert part.box.size == pytest.approx((4, 4), rel=0.01)
    # on the screen the arc runs clockwise from (10, 0) down to (0, 10)
    assert min(y for _, y in design.outline) == pytest.approx(-10)
    assert all(x >= -1e-9 for x, _ in design.outline)


@pytest.mark.parametrize(
    ("drawing", "expected"),
    [
        ("(gr_poly (pts (xy 0 0) (xy 40 0) (arc (start 40 0) (mid 60 20) (end 40 40)) (xy 0 40)) {})", 1600 + 200 * pi),
        (
            "(gr_poly (pts (arc (start 40 0) (mid 60 20) (end 40 40)) (arc (start 0 40) (mid -20 20) (end 0 0))) {})",
            1600 + 400 * pi,
        ),
        ("(gr_rect (start 0 0) (end 60 40) (radius 8) {})", 2400 - (4 - pi) * 64),
        ("(gr_rect (start 60 40) (end 0 0) (radius 30) {})", 800 + 400 * pi),
        ("(gr_rect (start 60 40) (end 0 0) {})", 2400),
    ],
)
def test_arcs_of_polygons_and_round_corners_of_rectangles(drawing: str, expected: float) -> None:
    design = read_kicad(f"(kicad_pcb {drawing.format('(layer Edge.Cuts)')})".encode(), PATH)
    assert area(design.outline) == pytest.approx(expected, rel=1e-3)
    assert not design.notes


DOT = '(fp_circle (center -2.45 1.75) (end -2.42 1.75) (layer "F.Fab"))'
SILK = '(fp_line (start -2.5 -2) (end 2.5 -2) (layer "F.SilkS")) (fp_line (start -2.5 2) (end 2.5 2) (layer "F.SilkS"))'
COURTYARD = '(fp_rect (start -2.75 -2.25) (end 2.75 2.25) (layer "F.CrtYd"))'


@pytest.mark.parametrize(
    ("drawing", "size"),
    [
        (DOT, (2.2, 0.8)),
        (DOT + SILK, (5, 4)),
        (DOT + COURTYARD + SILK, (5, 4)),
        (DOT + '(fp_line (start -0.2 -2.9) (end 0.2 -2.8) (layer "F.SilkS"))', (2.2, 3.3)),
        ('(fp_rect (start -0.25 -0.5) (end 0.25 0.5) (layer "F.Fab"))' + SILK, (0.5, 1)),
        ('(fp_line (start -2 -0.05) (end 2 0.05) (layer "F.Fab"))' + SILK, (5, 4)),
    ],
)
def test_a_drawing_much_smaller_than_the_pads_is_no_body(drawing: str, size: tuple[float, float]) -> None:
    text = f"""(kicad_pcb (footprint "L:U" (layer "F.Cu") (at 20 20) (property "Reference" "U1") {drawing}
        (pad "1" smd rect (at -0.8 0) (size 0.6 0.8)) (pad "2" smd rect (at 0.8 0) (size 0.6 0.8))))"""
    (part,) = read_kicad(text.encode(), PATH).parts
    assert part.box is not None
    assert part.box.size == pytest.approx(size)


@pytest.mark.parametrize(
    ("inside", "fitted", "in_bom"),
    [
        ("(attr smd)", True, True),
        ("(attr smd dnp)", False, True),
        ("(attr through_hole exclude_from_bom dnp)", False, False),
        ("(attr smd exclude_from_bom)", True, False),
        ('(property "dnp" "") (attr smd)', False, True),
        ('(property "exclude_from_bom" "") (attr smd)', True, False),
        ('(property "DNP" "") (attr smd)', True, True),
        ('(property "DNP" "yes") (attr smd)', False, True),
        ('(property "DNP" "DNP") (attr smd)', False, True),
        ("(fp_text value DNP (at 0 0))", False, True),
        ('(attr smd) (variant (name "LITE") (dnp yes))', True, True),
    ],
)
def test_what_is_not_fitted_or_not_in_the_bill_of_materials(inside: str, fitted: bool, in_bom: bool) -> None:
    text = f"""(kicad_pcb (footprint "L:R" (layer "F.Cu") (at 1 2) (property "Reference" "R1") {inside}
        (pad "1" smd rect (at 0 0) (size 1 1))))"""
    (part,) = read_kicad(text.encode(), PATH).parts
    assert (part.fitted, part.in_bom) == (fitted, in_bom)
