from __future__ import annotations

from pathlib import Path

import pytest

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
        ("ref,x,y\n# none\n", "b.csv: no line has a part with ref, x, y. Export it with its parts"),
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


HEADER = "Designator,X (mm),Y (mm),Rotation,Side,Comment\n"


def lines_read(design: Design) -> str:
    return next(note for note in design.notes if note.code == "lines-read")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("R9,20", "line 3 has 2 of 6 cells, it seems to be part R9"),
        ("R9,20,30,90", "line 3 has 4 of 6 cells, it seems to be part R9"),
        ("R9;20;30;90;Top;x", "line 3 seems to have another delimiter, semicolon: 'R9;20;30;90;Top;x'"),
        ("R9\t20\t30\t90\tTop\tx", "line 3 seems to have another delimiter, tab"),
        ("R9,20,5,30,5,90,Top,x", "line 3 has 8 of 6 cells, it seems to be part R9"),
        ("#R9,20,30,90,Top,x", "line 3 is a comment that holds R9"),
        ("Total: 2 parts", "line 3 has 1 of 6 cells: 'Total: 2 parts'"),
        (",20,30,90,Top,x", "line 3 has no designator or no place"),
        ('"R9","5", x","20","30","90","Top","x"', "line 3 has 8 of 6 cells, it seems to be part R9"),
        ("R9,20,5,30,Top,90,x", "line 3 has 7 of 6 cells, it seems to be part R9"),
    ],
)
def test_a_line_that_is_left_out_is_named_with_what_it_seems_to_hold(line: str, said: str) -> None:
    design = read(f"{HEADER}R1,10,20,90,Top,a\n{line}\nC1,60,50,0,Bottom,b\n")
    assert [part.ref for part in design.parts] == ["R1", "C1"]
    assert said in lines_read(design)
    assert "4 lines read: 2 parts, 1 header, 1 left out" in lines_read(design)


@pytest.mark.parametrize(
    "line",
    [
        "R9,20,30,90,Top,10k, 1%",
        'R9,20,30,90,Top,"10k\n1%"',
        'R9,20,30,90,Top,"HEADER .05""',
        'R9,20,30,90,Top,"HEADER .05\\""',
        'R9,20,30,90,Top,"a ""b"", c"',
        'R9,20,30,90,Top,"10k',
        "R9,20,30,90,Top,10k,,,",
    ],
)
def test_quotation_marks_and_commas_in_a_value_do_no_harm(line: str) -> None:
    design = read(f"{HEADER}R1,10,20,90,Top,a\n{line}\nC1,60,50,0,Bottom,b\n")
    assert {part.ref: (part.side, part.origin, part.rotation) for part in design.parts} == {
        "R1": ("top", (10, 20), 90), "R9": ("top", (20, 30), 90), "C1": ("bottom", (60, 50), 0),
    }  # fmt: skip
    assert "left out" not in lines_read(design)


@pytest.mark.parametrize(
    ("text", "role", "header", "given"),
    [
        ("Ref,X(mm),Y(mm),Side,Dir.\nR1,10,20,Top,90\nC1,60,50,Top,0\n", "rotation", "Dir.", "rotation=5"),
        ("Ref,X(mm),Y(mm),Side,Ugol\nR1,10,20,Top,90\nC1,60,50,Top,0\n", "rotation", "Ugol", "rotation=Ugol"),
        ("Ref,X(mm),Y(mm),Side,Dir.\nR1,10,20,Top,90\nC1,60,50,Top,0\n", "rotation", "Dir.", "rotation=none"),
        ("Ref,X(mm),Y(mm),Rot,Lg\nR1,10,20,0,T\nC1,60,50,0,B\n", "side", "Lg", "side=5"),
        ("Ref,X(mm),Y(mm),Rot,Type\nR1,10,20,0,Top\nC1,60,50,0,Top\n", "side", "Type", "side=Type"),
        ("Ref,X(mm),Y(mm),Rot,Lg\nR1,10,20,0,1\nC1,60,50,0,2\n", "side", "Lg", "side=Lg"),
        ("Ref,X(mm),Y(mm),Rot,Cara\n" + "R1,1,2,0,Haut\nR2,3,2,0,Bas\n" * 3, "side", "Cara", "side=bottom"),
    ],
)
def test_a_column_that_is_not_understood_is_never_taken_as_absent(
    text: str, role: str, header: str, given: str
) -> None:
    with pytest.raises(InputError, match=f"no column is recognised as the {role}, but it may be '{header}'") as refused:
        read(text)
    assert f"--columns {role}=5" in refused.value.action
    assert read(text, columns=given).parts, "what the message advises is accepted"


@pytest.mark.parametrize("header", ["Teil,Ort_X,Ort_Q,Dreh,Lg", "a;b;c;d;e", "Uno Due Tre Quattro Cinque"])
def test_a_header_in_other_words_is_no_absent_header(header: str) -> None:
    delimiter = next(d for d in ";, " if d in header)
    lines = [delimiter.join(cells) for cells in (("R1", "10", "20", "90", "T"), ("C1", "60", "50", "0", "B"))]
    text = "\n".join([header, *lines])
    with pytest.raises(InputError, match=r"line 1: the header .* has no column that is recognised as"):
        read(text, units="mm")
    design = read(text, units="mm", columns="ref=1,x=2,y=3,rotation=4,side=5")
    assert [(part.ref, part.origin, part.rotation, part.side) for part in design.parts] == [
        ("R1", (10, 20), 90, "top"), ("C1", (60, 50), 0, "bottom"),
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["relay-bottom.csv", "PnP_relay_back.csv", "relay Bot.txt", "PickPlaceBottom.csv"])
def test_the_side_of_all_parts_is_that_of_the_name_of_the_file(name: str) -> None:
    text = "ref,x (mm),y (mm),rotation\nR1,1,2,0\n"
    design = read_placement_table(text.encode(), Path(name), TableOptions())
    assert design.parts[0].side == "bottom"
    assert any("those of the bottom, by the name of the file" in note for note in design.notes)
    by_line = read_placement_table(f"# Board Side: Top\n{text}".encode(), Path(name), TableOptions())
    assert by_line.parts[0].side == "top"
    assert any("those of the top, by line 1" in note for note in by_line.notes)


@pytest.mark.parametrize(
    ("xs", "negated"),
    [((-60, -20), True), ((-60, 20), False), ((-60, -190), False), ((-10, -90), True), ((60, 20), False)],
)
def test_negated_x_of_the_bottom_is_made_positive_where_the_top_shows_it(xs: tuple[int, int], negated: bool) -> None:
    top = "R1,10,20,90,Top,a\nR2,90,20,90,Top,a\n"
    design = read(f"{HEADER}{top}C1,{xs[0]},50,90,Bottom,b\nC2,{xs[1]},50,0,Bottom,b\n")
    bottom = [part for part in design.parts if part.side == "bottom"]
    assert [part.origin[0] for part in bottom] == [-x if negated else x for x in xs]
    assert bottom[0].rotation == 90
    assert any("the bottom is negated" in note for note in design.notes) == negated


def places(text: str) -> list[tuple[object, ...]]:
    return [(p.ref, p.side, round(p.origin[0], 2), round(p.origin[1], 2), p.rotation) for p in read(text).parts]


R1, C1 = ("R1", "top", 10.0, 20.0, 90.0), ("C1", "bottom", 30.0, 40.0, 0.0)


@pytest.mark.parametrize(
    "text",
    [
        "Ref;X (mm);Y (mm);Rot;Seite\nR1;10;20;90;B\nC1;30;40;0;L\n",
        "Ref;X (mm);Y (mm);Rot;Unterseite\nR1;10;20;90;nein\nC1;30;40;0;ja\n",
        "Ref;X (mm);Y (mm);Rot;Top side\nR1;10;20;90;X\nC1;30;40;0;\n",
        "Ref;X (mm);Y (mm);Rot\nTop side\nR1;10;20;90\nBottom side\nC1;30;40;0\n",
        "Ref;X (mm);Y (mm);Rot;Side\nR1;10;20;90 Deg;Copper Top\nC1;30;40;0 Deg;Copper Bottom\n",
        "Ref;X;Y;Rot;Side\n;mm;mm;deg;\nR1;10;20;90;Top\nC1;30;40;0;Bottom\n",
        "Alle Maße in mm\nRef;X;Y;Rot;Side\nR1;10;20;90;Top\nC1;30;40;0;Bottom\n",
        "Ref;X;Y;Unit;Rot;Side\nR1;10;20;mm;90;Top\nC1;30;40;mm;0;Bottom\n",
        "Ref;X;Y;Rot;Side\nR1;10MM;20MM;90;Top\nC1;30MM;40MM;0;Bottom\n",
        "Height unit: mil\nUnits used: mm\nRef;X;Y;Rot;Side\nR1;10;20;90;Top\nC1;30;40;0;Bottom\n",
        "Ref;Mid X;Mid Y;Ref X;Ref Y;Rot;Side\nR1;;;10mm;20mm;90;Top\nC1;;;30mm;40mm;0;Bottom\n",
        "# Rotation: degrees clockwise\nRef;X (mm);Y (mm);Rot;Side\nR1;10;20;270;Top\nC1;30;40;0;Bottom\n",
        "UUNITS = MILLIMETERS\nR1 ! 10.00 20.00 ! 90.000 ! ! R0603\nC1 ! 30.00 40.00 ! 0.000 ! m ! C0402\n",
        "Designator Mid X Mid Y Layer Rotation\nR1 10mm 20mm Top 90\nC1 30mm 40mm Bot 0\n",
        "X [mm] Y [mm] Ref  Rot Side\n10.00  20.00 R1    90 Top\n30.00  40.00 C1     0 Bot\n",
        "Ref     X(mm)  Y(mm)  Rot     Comment  Side\n R1     10.00  20.00   90  100 nF 50V   Top\n"
        " C1     30.00  40.00    0  100 nF 16V   Bot\n",
        "Ref\tX(mm)\tY(mm)\tRot\tSide\nR1\t10\t20\t90\tTop\t\nC1\t30\t40\t0\tBottom\t\n",
        'Ref;X (mm);Y (mm);Rot;Side;Value\nR1;10;20;90;Top;"HDR 2.54"" pitch\nC1;30;40;0;Bottom;"x"\n',
        "Ref;X (mm);Y (mm);Rot\nSolder jumpers\nR1;10;20;90\n# Bottom\nC1;30;40;0\n",
        "Top (1 part)\nRef;X (mm);Y (mm);Rot\nR1;10;20;90\nBottom (1 part)\nC1;30;40;0\n",
        'Ref;X (mm);Y (mm);Rot;Side\n""\n"R1";10;20;90;Top\nC1;30;40;0;Bottom\n',
        '"Report of 25 mil"\nRef;X (mm);Y (mm);Rot;Side\nR1;10.000;20;90;Top\nC1;30.000;40;0;Bottom\n',
        "Ref;XMM;YMM;Winkel (im Uhrzeigersinn);Side\nR1;10;20;270;Top\nC1;30;40;0;Bottom\n",
        "# Rotation: CCW (not CW)\nRef;X (mm);Y (mm);Rot;Side\nR1;10;20;90;Top\nC1;30;40;0;Bottom\n",
        "Ref;X (mm);Y (mm);Rotation (counter clockwise);Side\nR1;10;20;90;Top\nC1;30;40;0;Bottom\n",
        "Ref;Part;X (mm);Y (mm);Rot;Side\n1;R1;10;20;90;Top\n2;C1;30;40;0;Bottom\n",
        "Ref,Pick X (mm),Pick Y (mm),Place X (mm),Place Y (mm),Rot,Side\nR1,1,2,10,20,90,Top\nC1,3,4,30,40,0,Bottom\n",
        "Ref,X (mm),Y (mm),Rot,Side,Description\nR1,10,20,90,Top,x\nC1,30,40,0,Bottom\n",
        'Part,Value,Position (mm),Orientation\nR1,1k,"(10, 20)",R90\nC1,1n,"(30, 40)",MR0\n',
        "Reference PosX [mm] PosY [mm]  Rot Side\nR1        10.0      20.0        90 Top\n"
        "C1        30.0      40.0         0 Bot\n",
    ],
)
def test_unusual_tables_are_read_as_they_are_meant(text: str) -> None:
    assert places(text) == [R1, C1]


@pytest.mark.parametrize(
    ("text", "refs"),
    [
        ("Designator,Part,X (mm),Y (mm),Rot,Layer\nR001,BC847,1,2,90,Top\nC002,LM358,3,4,0,Top\n", ["R001", "C002"]),
        ("Name,Component,X (mm),Y (mm),Rot,Layer\nX$1,BC847,1,2,90,Top\nD?,LM358,3,4,0,Top\n", ["X$1", "D?"]),
        ("Bezeichner;Bauteil;X (mm);Y (mm);Rot;Seite\n1J5;BC847;1;2;90;Oben\nUSB;LM358;3;4;0;Oben\n", ["1J5", "USB"]),
        ("Bauteil-Nr,Device,X (mm),Y (mm),Rot,Layer\nR01,BC847,1,2,90,Top\nC02,LM358,3,4,0,Top\n", ["R01", "C02"]),
        ("C1 10 10 0 100n C0402\nC2 15 75 270 1u C0402\nR1 15 70 270 1k R0402\nR2 15 25 270 2k R0402\n",
         ["C1", "C2", "R1", "R2"]),
    ],
)  # fmt: skip
def test_designators_of_all_kinds(text: str, refs: list[str]) -> None:
    assert [part.ref for part in read(text).parts] == refs


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Ref,X(mm),Y(mm),,Ref,X(mm),Y(mm)\nR1,100,200,,C1,60,50\n", "names the columns of ref and x and y twice"),
        ("Ref,X (mm),Y (mm),Rot\nR1,10,5,20,3,90\nR2,30,5,40,3,0\n", "2 lines cannot be read as parts"),
        ("Ref,Value,X (mm),Y (mm),Rot\nR1,10k,1%,10,20,90\nR2,1k,1%,30,40,0\n", "2 of 2 lines have more cells than"),
        ('Ref,X(mil),Y(mil),Rot\nR1,"1,000",500,0\nR2,"2,400","2,500",0\n', "'1,000' may have a decimal comma, or"),
        ("Ref,X(0.01mm),Y(0.01mm),Rot\nR1,100,200,0\n", "states the unit '0.01mm'"),
        ("Ref,X(mm/100),Y(mm/100),Rot\nR1,100,200,0\n", "states the unit 'mm/100'"),
        ('Ref,X(1/1000"),Y(1/1000"),Rot\nR1,100,200,0\n', "states the unit '1/1000\"'"),
        ("Ref,X (mm),Y (mm),Rot (1/10 deg)\nR1,100,200,900\n", "states rotations in '1/10', but they must be degrees"),
        ('Ref,X(mil),Y(mil),Rot\nR1,"1,025","2,300",0\n', "'1,025' may have a decimal comma, or separate thousands"),
        ("Ref,X (mm),Y (mm),Rot,Side\nR1,1,2,0,BS\n", "side is 'BS', but must be top or bottom"),
        ("Ref,X (mm),Y (mm),Rot,Mount\nR1,1,2,0,T\nR2,1,3,0,B\n", "as the side, but it may be 'Mount'"),
        ("Ref,X (mm),Y (mm),Dir,Note\nR1,1,2,90\nR2,1,3,0\n", "as the rotation, but it may be 'Dir'"),
        ("R1,0402,10,15,90\nR2,0402,30,40,90\n", "its lines are not designator, x, y, rotation"),
        ("X(mm) Y(mm) Comment Ref Height\n12 11 R 10 D1\n12 14 1n C2\n", "lines cannot be read as parts"),
        ("# in mm\n# in mils\nRef,X,Y,Rot\nR1,100,200,0\n", "states several units: mm in line 1, mil in line 2"),
        ("Ref,X (mm),Y (mm),Rot\nR1,1,2,90\nRef,Rot,X (mm),Y (mm)\nC1,0,60,50\n", "line 3: is a second header with"),
        ("Ref,X (mm),Y (mm),Rot\nR1,(10.5),2,90\n", r"line 2: x is '\(10.5\)', but must be a number"),
        ("Ref,X (mm),Y (mm),Orientation\nR1,10.5,2,East\n", "rotation is 'East', but must be a number from -360"),
        ("R1,10.2,20.3,0,90\nC1,30.2,70.3,0,180\nC2,30.2,44.3,1,180\n", "its lines are not designator, x, y, rotation"),
        ("Ref,Val,PosX,PosY,Rot,Side\nR1,10k,1,1,90,top\nR2,10k,9,5,90,top\n", "usual board in mm and in inch"),
        (
            "Ref,X(mm),Y(mm),Rot,Lg\nR1,1,2,90,T,\nR2,3,4,0,B,\n",
            "no column is recognised as the side, but it may be 'Lg'",
        ),
    ],
)
def test_a_table_that_may_mean_several_things_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read(text)
