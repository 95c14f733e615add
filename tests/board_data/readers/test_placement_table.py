from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.design import Design
from vaoi_station.board_data.readers.placement_table import TableOptions, read_placement_table
from vaoi_station.errors import InputError

PATH = Path("b.csv")


def read(text: str, **options: str | None) -> Design:
    table = TableOptions.parse(options.get("units"), options.get("columns"), options.get("delimiter"))
    return read_placement_table(text.encode(), PATH, table)


ALTIUM = """Altium Designer Pick and Place Locations
Units used: mil

"Designator","Comment","Layer","Footprint","Center-X(mil)","Center-Y(mil)","Rotation"
"R1","10k, 1%","TopLayer","0805","393.7008","393.7008","0"
"C1","","BottomLayer","0402","590.5512","984.252","270"
"""
KICAD = """### Footprint positions ###
## Unit = inches, Angle = deg.
# Ref     Val            Package                PosX       PosY       Rot  Side
R1        10k 1 %        R_0805_2012Metric      0.3937     0.3937    0.0000  top
C1                       C_0402_1005Metric      0.5906     0.9843  -90.0000  bottom
"""
GERMAN = "Bauteil;RefDes;Gehäuse;X (mm);Y (mm);Winkel;Side\nx;R1;0805;10,0;10,0;0;T\ny;C1;0402;15,0;25,0;270;B\n"
ALLEGRO = "UUNITS = MILS\nR1  393.7008  393.7008  0    R0805\nC1  590.5512  984.252  270  m C0402\n"
EAGLE = "E$1 1 2 0 10k R0603\nR1 10.00 10.00 0 10k R0805\nC1 15.00 25.00 270 1u C0402\n"


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (ALTIUM, {}),
        (KICAD, {}),
        (GERMAN, {"columns": "rotation=Winkel,package=3"}),
        (ALLEGRO, {}),
        (EAGLE, {"units": "mm"}),
        (ALTIUM.replace('"', "").replace("10k, 1%", "10k").replace(",", "\t"), {}),
    ],
)
def test_tables_of_many_programs(text: str, options: dict[str, str]) -> None:
    parts = {part.ref: part for part in read(text, **options).parts}
    assert parts.keys() - {"E$1"} == {"R1", "C1"}
    assert parts["R1"].origin == pytest.approx((10, 10), abs=0.002)
    assert parts["C1"].origin == pytest.approx((15, 25), abs=0.002)
    assert (parts["R1"].rotation, parts["C1"].rotation) == (0, 270)
    assert "0402" in parts["C1"].package
    assert (parts["R1"].side, parts["C1"].side) == ("top", "top" if text is EAGLE else "bottom")


def test_what_was_recognised_is_said() -> None:
    note = read(ALTIUM).notes[0]
    assert "delimiter comma; ref: column 1, x: column 5, y: column 6, rotation: column 7, side: column 3" in note
    assert "unit mil (by the header)" in note
    assert any("no column states the side" in note for note in read(EAGLE, units="mm").notes)


def test_the_side_of_a_file_of_one_side_is_stated_by_the_user_or_its_suffix() -> None:
    text = "ref,x (mm),y (mm)\nR1,1,2\n"
    for options, side in (({}, "top"), ({"columns": "side=bottom"}, "bottom"), ({"columns": "side=Top"}, "top")):
        design = read(text, **options)
        assert [part.side for part in design.parts] == [side]
        assert any("no column states the side" in note for note in design.notes) == (not options)
    eagle = read_placement_table(EAGLE.encode(), Path("b.mnb"), TableOptions("mm"))
    assert {part.side for part in eagle.parts} == {"bottom"}
    assert any("are taken as those of the bottom" in note for note in eagle.notes)
    stated = read("ref,x (mm),y (mm),side\nR1,1,2,top\n", columns="side=bottom")
    assert (stated.parts[0].side, stated.table and stated.table.all_on) == ("bottom", "bottom")
    assert read(ALLEGRO, columns="side=bottom").parts[1].package == "C0402"


def test_parts_that_are_not_fitted_are_marked() -> None:
    def fitted(header: str, *cells: str, **options: str) -> list[bool]:
        lines = "".join(f"R{n},{n},0,{cell}\n" for n, cell in enumerate(cells))
        return [part.fitted for part in read(f"ref,x (mm),y (mm),{header}\n{lines}", **options).parts]

    assert fitted("DNP", "", "DNP", "yes", "no", "1", "x") == [True, False, False, True, False, False]
    assert fitted("Fitted", "yes", "No", "Not Fitted", "", "false") == [True, False, False, True, False]
    assert fitted("Populate", "0", "1") == [False, True]
    assert fitted("Comment", "10k", "DNP") == [True, False]
    assert fitted("a", "n", "y", columns="fitted=4") == [False, True]


def test_parts_without_a_place_are_left_out_and_named() -> None:
    design = read("ref,x (mm),y (mm)\nR1,1,2\nR2,,\n")
    assert [part.ref for part in design.parts] == ["R1"]
    assert "1 parts without x and y were left out: R2." in design.notes


def test_the_centre_is_preferred_to_the_reference_point() -> None:
    text = "Designator,Ref X(mm),Ref Y(mm),Mid X(mm),Mid Y(mm)\nU1,1,2,3,4\nU2,5,6,7,8\n"
    assert read(text).parts[0].origin == (3, 4)
    assert read(text, columns="x=Ref X,y=3").parts[0].origin == (1, 2)


def test_units_of_the_values_and_of_a_usual_board() -> None:
    assert read("ref,x,y\nR1,10mm,20mm\nR2,11mm,20mm\n").parts[0].origin == (10, 20)
    table = read("ref,x,y\nR1,0,0\nR2,160,90\n")
    assert "unit mm (the only one at which the board has a usual size" in table.notes[0]
    with pytest.raises(
        InputError, match="states no unit, and its parts are 20 units apart, which is a usual board in mm"
    ):
        read("ref,x,y\nR1,0,0\nR2,20,9\n")
    with pytest.raises(InputError, match="Give --units mm, inch or mil"):
        read("ref,x,y\nR1,0,0\nR2,0.1,0.2\n")


@pytest.mark.parametrize("unit", ["cm", "um", "µm", "m", "micron", "Centimetres", "nm"])
def test_another_unit_is_refused_unless_the_user_states_one(unit: str) -> None:
    """A file in cm would else be read in inches, the only unit at which its board has a usual size."""
    for text in (f"ref,x({unit}),y [{unit}]\nR1,0,0\nR2,16,9\n", f"# Unit: ({unit})\nref,x,y\nR1,0,0\nR2,16,9\n"):
        with pytest.raises(InputError, match=r"states the unit '\w+' \(by .*\), but must be one of"):
            read(text)
        assert read(text, units="mm").parts[1].origin == (16, 9)
    assert read("ref,x (center),y (center)\nR1,0mm,0mm\nR2,16mm,9mm\n").parts[1].origin == (16, 9)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("ref,x,y\nR1,ten,10\n", "b.csv, line 2: x is 'ten', but must be a number"),
        ("ref,x,y\nR1,,10\n", "b.csv, line 2: x is '', but must be a number"),
        ("ref,x,y,side\nR1,1,10,left\n", "b.csv, line 2: side is 'left', but must be top or bottom"),
        ("a,b,c\n1,2,3\n", "has no header with columns ref, x, y"),
        ("", "has no header"),
        ("ref,x,y\n# none\n", "b.csv: no line has a part with ref, x, y. Name the columns by --columns"),
        ("ref,x(mm),y(mil)\nR1,1,1\n", "its header has x in mm and y in mil"),
    ],
)
def test_wrong_tables_are_refused(text: str, message: str) -> None:
    units = "mm" if "mil" not in text and "none" not in text else None
    with pytest.raises(InputError, match=message):
        read(text, units=units)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"units": "cm"}, "the unit is 'cm', but must be mm, inch, mil"),
        ({"delimiter": "ab"}, "the delimiter is 'ab', but must be one character"),
        ({"columns": "place=1"}, "an entry is 'place=1', but must be NAME=COLUMN"),
        ({"columns": "x=²"}, "--columns x is '²', but must be a number from 1 to 7, or a header"),
        ({"columns": "x=Nowhere"}, "--columns x is 'Nowhere', but must be a number from 1 to 7, or a header"),
        ({"columns": "ref=1,x=99"}, "--columns x is '99', but must be a number from 1 to 7, or a header of .'Design"),
    ],
)
def test_wrong_options_are_refused(options: dict[str, str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(ALTIUM, **options)


@given(st.text(alphabet='ref,xy;\t "m0.-1\n#R', max_size=120))
def test_any_text_is_read_or_refused(text: str) -> None:
    with contextlib.suppress(InputError):
        assert read(text).parts
