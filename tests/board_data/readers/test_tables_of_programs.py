"""Centroid files as CAD programs write them: the same parts in the layout, words and units of every program."""

# ruff: noqa: E501  (lines of the formats)

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.design import Design
from vaoi_station.board_data.readers.placement_table import TableOptions, read_placement_table

# R1 and U1 on the top, C1 on the bottom. Places are multiples of 1 mil and of 0.0254 mm.
TRUTH = {
    "R1": ("top", 25.4, 12.7, 90.0),
    "C1": ("bottom", 60.96, 63.5, 180.0),
    "U1": ("top", 76.2, 50.8, 45.0),
}

PROGRAMS = {
    "altium csv": """Altium Designer Pick and Place Locations
C:\\pcb\\Pick Place for relay.csv

========================================================================================================================
File Design Information:

Date:       03/03/20
Units used: mil

"Designator","Comment","Layer","Footprint","Center-X(mil)","Center-Y(mil)","Rotation","Description"
"R1","10k, 1%","TopLayer","RES 0603","1000.000","500.000","90","Chip resistor, 1 %"
"C1","100n","BottomLayer","0402","2400.000","2500.000","180",""
"U1","LM358","TopLayer","SO8","3000.000","2000.000","45","Dual 0.1" amplifier"
""",
    "altium text": """Altium Designer Pick and Place Locations

Units used: mm

Designator Comment    Layer       Footprint  Center-X(mm) Center-Y(mm) Rotation Description
R1         10k 1%     TopLayer    RES 0603   25.4000      12.7000      90       "Chip resistor, 1 %"
C1                    BottomLayer 0402       60.9600      63.5000      180      ""
U1         LM358 D    TopLayer    SO8        76.2000      50.8000      45       "Header .1" 8 way"
""",
    "protel": """Designator Footprint          Mid X         Mid Y         Ref X         Ref Y         Pad X         Pad Y TB      Rotation Comment

R1         0603              1000mil        500mil       1010mil        510mil        990mil        500mil  T         90.00 10k 1%
C1         0402              2400mil       2500mil       2400mil       2500mil       2390mil       2500mil  B        180.00
U1         SO8               3000mil       2000mil       2900mil       1900mil       2900mil       1900mil  T         45.00 LM 358
""",
    "allegro": "UUNITS = MILS\nR1     1000.000   500.000   90    R0603\nC1     2400.000  2500.000  180  m C0402\n"
    "U1     3000.000  2000.000   45    SO8\n",
    "allegro report": """REFDES,COMP_DEVICE_TYPE,COMP_VALUE,COMP_TOL,COMP_PACKAGE,SYM_X,SYM_Y,SYM_ROTATE,SYM_MIRROR
R1,RES_0603_10K,10k,1%,R0603,1000.0,500.0,90.000,NO
C1,CAP_0402,100n,,C0402,2400.0,2500.0,180.000,YES
U1,LM358,LM358,,SO8,3000.0,2000.0,45.000,NO
""",
    "pads": """RefDes,PartType,PartDecal,Pins,Layer,Orient.,X (Mils),Y (Mils),SMD,Glued
R1,RES-10K,0603,2,Top,90.000,1000,500,Yes,No
C1,CAP-100N,0402,2,Bottom,180.000,2400,2500,Yes,No
U1,LM358,SO8,8,Top,45.000,3000,2000,Yes,No
""",
    "pads numbers of layers": "RefDes\tPartDecal\tLayer\tOrient\tX\tY\nR1\t0603\t1\t90\t25.4\t12.7\nC1\t0402\t4\t180\t60.96\t63.5\n"
    "U1\tSO8\t1\t45\t76.2\t50.8\n",
    "xpedition": """Ref Des   Part Number   Cell Name    X (TH)    Y (TH)   Rotation  Side
R1        RES-0001      R0603        1000      500      90        Top
C1        CAP-0002      C0402        2400      2500     180       Bottom
U1        IC-0003       SO8          3000      2000     45        Top
""",
    "diptrace": "RefDes,Name,Pattern,X (mm),Y (mm),Side,Rotate,Value,Height(mm)\nR1,RES,R0603,25.4,12.7,Top,90,10k,0.5\n"
    "C1,CAP,C0402,60.96,63.5,Bottom,180,100n,0.5\nU1,OPAMP,SO8,76.2,50.8,Top,45,LM358,1.7\n",
    "designspark": '"Name","Component","Package","Position X","Position Y","Place X","Place Y","Rotation","Side"\n'
    '"R1","RES10K","0603","24.1","12.7","25.4","12.7","90","Top"\n'
    '"C1","CAP100N","0402","60.96","62","60.96","63.5","180","Bottom"\n"U1","LM358","SO8","74","50","76.2","50.8","45","Top"\n',
    "pulsonix": "Ref Name,Part Name,Side,Placement Centre X,Placement Centre Y,Rotation\nR1,RES1,Top,25.4,12.7,90\n"
    "C1,CAP1,Bottom,60.96,63.5,180\nU1,LM358,Top,76.2,50.8,45\n",
    "eagle part list": """Partlist exported from relay.brd at 03.03.20 10:00

Part     Value          Package      Library  Position (mil)        Orientation

R1       10k            0603         rcl      (1000 500)            R90
C1       100n           C0402        rcl      (2400 2500)           MR180
U1       LM358          SO08         linear   (3000 2000)           R45
""",
    "fusion": "Name,X,Y,Angle,Value,Package,Side\nR1,25.40,12.70,90,10k,0603,Front\nC1,60.96,63.50,180,100n,C0402,Back\n"
    "U1,76.20,50.80,45,LM358,SO8,Front\n",
    "easyeda": "Designator,Footprint,Mid X,Mid Y,Ref X,Ref Y,Pad X,Pad Y,Layer,Rotation,Comment\n"
    "R1,0603,25.4mm,12.7mm,25.4mm,12.7mm,24.6mm,12.7mm,T,90,10k\n"
    "C1,0402,60.96mm,63.5mm,60.96mm,63.5mm,60mm,63.5mm,B,180,100n\nU1,SO8,76.2mm,50.8mm,76mm,50mm,74mm,49mm,T,45,LM358\n",
    "easyeda pro": "Designator\tDevice\tFootprint\tMid X\tMid Y\tRef X\tRef Y\tPad X\tPad Y\tPins\tLayer\tRotation\tSMD\tComment\n"
    "R1\tRES10K\t0603\t1000mil\t500mil\t1000mil\t500mil\t990mil\t500mil\t2\tT\t90\tYes\t10k\n"
    "C1\tCAP1\t0402\t2400mil\t2500mil\t1mil\t1mil\t1mil\t1mil\t2\tB\t180\tYes\t100n\n"
    "U1\tLM358\tSO8\t3000mil\t2000mil\t1mil\t1mil\t1mil\t1mil\t8\tT\t45\tYes\tLM358\n",
    "proteus": """LABCENTER PROTEUS PICK AND PLACE FILE
=====================================

Component positions for C:\\relay.pdsprj

Fields: Part ID, Value, Package, Layer, Rotation, X, Y
Units: Rotation - degrees, X, Y - thou
Notes:  The X, Y value is the centre of package as drawn in ARES.
The origin for these values is the User Origin.
The values are a comma separated list.

"R1","10k","0603",TOP,90,1000,500
"C1","100n","0402",BOT,180,2400,2500
"U1","LM358","SO8",TOP,45,3000,2000
""",
    "librepcb": """# Pick&Place Position Data File
#
# Unit:                mm
# Rotation:            Degrees CCW
# Board Side:          Both
#
Designator,Value,Device,Package,Position X,Position Y,Rotation,Side,Type
R1,10k,R-0603,R-0603,25.4,12.7,90.0,Top,SMT
C1,100n,C-0402,C-0402,60.96,63.5,180.0,Bottom,SMT
U1,LM358,LM358D,SO8,76.2,50.8,45.0,Top,SMT
""",
    "geda": """# PcbXY Version 1.0
# Title: relay - PCB X-Y
# RefDes, Description, Value, X, Y, rotation, top/bottom
# X,Y in mils.  rotation in degrees.
# --------------------------------------------
R1,"0603","10k",1000.00,500.00,90,top
C1,"0402","100n",2400.00,2500.00,180,bottom
U1,"SO8","LM358",3000.00,2000.00,45,top
""",
    "pcb-rnd macrofab": "#Designator\tX-Loc\tY-Loc\tRotation\tSide\tType\tX-Size\tY-Size\tValue\tFootprint\tPopulate\tMPN\n"
    "R1\t1000\t500\t90\t1\t1\t63\t32\t10k\t0603\t1\t\nC1\t2400\t2500\t180\t2\t1\t40\t20\t100n\t0402\t1\t\n"
    "U1\t3000\t2000\t45\t1\t1\t200\t240\tLM358\tSO8\t0\t\n",
    "kicad csv": 'Ref,Val,Package,PosX,PosY,Rot,Side\n"R1","10k","R_0603",25.400000,12.700000,90.000000,top\n'
    '"C1","100n, X7R","C_0402",60.960000,63.500000,180.000000,bottom\n"U1","LM358","SO8",76.2,50.8,45.0,top\n',
    "kicad text": """### Footprint positions - created on 2024-01-01T00:00:00 ###
### Printed by KiCad version 8.0.0
## Unit = mm, Angle = deg.
## Side : All
# Ref     Val       Package                PosX       PosY       Rot  Side
R1        10k       R_0603_1608Metric   25.4000    12.7000   90.0000  top
C1        100n      C_0402_1005Metric   60.9600    63.5000  180.0000  bottom
U1        LM358     SOIC-8_3.9x4.9mm    76.2000    50.8000   45.0000  top
## End
""",
    "cr-5000": """Reference   PartName     PackageName   X           Y           Angle    PlacementSide
R1          RES10K       R1608         25.400      12.700      90.000   A
C1          CAP100N      C1005         60.960      63.500      180.000  B
U1          LM358        SOP8          76.200      50.800      45.000   A
""",
    "orcad layout": """Comp Name | Footprint | Center X | Center Y | Rotation | Mirror
R1 | R0603 | 1000 | 500 | 90 | No
C1 | C0402 | 2400 | 2500 | 180 | Yes
U1 | SO8 | 3000 | 2000 | 45 | No
""",
    "target german": "Bezeichner;Wert;Gehäuse;X-Pos [mm];Y-Pos [mm];Drehwinkel;Seite\nR1;10k;0603;25,4;12,7;90;Oben\n"
    "C1;100n;0402;60,96;63,5;180;Unten\nU1;LM358;SO8;76,2;50,8;45;Oben\n",
    "altium german": '"Bezeichner","Kommentar","Lage","Footprint","Mittelpunkt-X(mm)","Mittelpunkt-Y(mm)","Drehung","Beschreibung"\n'
    '"R1","10k","TopLayer","0603","25,400","12,700","90","Widerstand"\n'
    '"C1","100n","BottomLayer","0402","60,960","63,500","180",""\n"U1","LM358","TopLayer","SO8","76,200","50,800","45",""\n',
    "assembly house german": "Bauteil;Bauform;Bestückungsseite;X-Koordinate (mm);Y-Koordinate (mm);Winkel;bestückt\n"
    "R1;0603;Oberseite;25,4;12,7;90;ja\nC1;0402;Unterseite;60,96;63,5;180;ja\nU1;SO8;Oberseite;76,2;50,8;45;nein\n",
    "assembly house, both sides": ";;;;;;;;;;;\nRefDes;IC-Art#;Value;PartDecal;Orient.;X;Y;Seite;Class;PinCnt\n"
    "R1;201.000;10k;0603;90;25.4;12.7;Oben;SMD;2\nC1;;100n;0402;180;60.96;63.5;Unten;SMD;2\n"
    "U1;;LM358;SO8;45;76.2;50.8;Oben;DNP;8\n;;;;;;;;;\n",
    "excel": "sep=;\nReference Designator;Center X (in);Center Y (in);Board Side;Orientation (deg)\nR1;1.0;0.5;TOP;90\n"
    "C1;2.4;2.5;BOT;180\nU1;3.0;2.0;TOP;45\n",
    "thousands": 'RefDes,X(mil),Y(mil),Side,Rotate\nR1,"1,000.0",500,Top,90\nC1,"2,400","2,500",Bottom,180\nU1,"3,000","2,000",Top,45\n',
}  # fmt: skip


def read(text: str, name: str = "b.csv", **options: str) -> Design:
    table = TableOptions.parse(options.get("units"), options.get("columns"), options.get("delimiter"))
    return read_placement_table(text.encode(), Path(name), table)


def placed(design: Design) -> dict[str, tuple[str, float, float, float]]:
    return {p.ref: (p.side, round(p.origin[0], 4), round(p.origin[1], 4), p.rotation) for p in design.parts}


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_part_lies_at_its_place_and_angle_on_its_side(program: str) -> None:
    design = read(PROGRAMS[program])
    expected = dict(TRUTH)
    if program == "eagle part list":  # rotated, then mirrored: −180° as seen from the top
        expected["C1"] = ("bottom", 60.96, 63.5, 180.0)
    assert placed(design) == expected


@pytest.mark.parametrize("program", PROGRAMS)
def test_every_line_is_accounted_for(program: str) -> None:
    note = next(note for note in read(PROGRAMS[program]).notes if note.code == "lines-read")
    counts = [int(n) for n in re.findall(r"(\d+) (?:parts|header|continued|comments|left)", note)]
    assert sum(counts) == int(note.values["lines"]) == len(PROGRAMS[program].splitlines())
    assert note.values["parts"] == "3"


@pytest.mark.parametrize(
    ("program", "unfitted"),
    [("assembly house german", {"U1"}), ("assembly house, both sides", {"U1"}), ("pcb-rnd macrofab", {"U1"})],
)
def test_parts_that_are_not_fitted(program: str, unfitted: set[str]) -> None:
    assert {part.ref for part in read(PROGRAMS[program]).parts if not part.fitted} == unfitted


REFS = st.lists(
    st.builds("{}{}".format, st.sampled_from(["R", "C", "U", "IC", "LED"]), st.integers(1, 999)),
    min_size=4, max_size=12, unique=True,
)  # fmt: skip
COLUMNS_IN_WORDS = {
    "ref": ["Designator", "RefDes", "Reference", "Name", "Part", "Bezeichner", "Comp Name"],
    "x": ["X", "Mid X", "Center-X", "PosX", "Position X", "X-Koordinate", "CenterX", "X Location"],
    "rotation": ["Rotation", "Rot", "Angle", "Orientation", "Drehung", "Winkel", "Theta"],
    "side": ["Side", "Layer", "TB", "Seite", "Board Side"],
    "extra": ["Value", "Comment", "Footprint", "Description", "Supplier", "Gehäuse"],
}
SIDES_IN_WORDS = [("Top", "Bottom"), ("T", "B"), ("TopLayer", "BottomLayer"), ("Oben", "Unten"), ("F.Cu", "B.Cu")]
DECORATIONS = {"plain": ("", ""), "in brackets": (" (mm)", ""), "in values": ("", "mm")}


@given(refs=REFS, data=st.data())
def test_any_order_of_columns_and_any_words_give_the_same_parts(refs: list[str], data: st.DataObject) -> None:
    """Delimiters, alignment, decimal comma, order, words, units and further columns vary; the parts do not."""
    draw = data.draw
    delimiter = draw(st.sampled_from([",", ";", "\t", "|", "left", "right"]))
    comma = draw(st.booleans()) and delimiter != ","
    place = st.floats(1, 200).map(lambda v: round(v, 2))
    truth = {
        ref: (
            draw(st.sampled_from(["top", "bottom"])),
            draw(place),
            draw(place),
            draw(st.sampled_from([0, 45, 90, 270])),
        )
        for ref in refs
    }
    names = {role: draw(st.sampled_from(words)) for role, words in COLUMNS_IN_WORDS.items()}
    names["y"] = names["x"].replace("X", "Y")
    suffix, unit = DECORATIONS[draw(st.sampled_from(sorted(DECORATIONS)))]
    names |= {axis: names[axis] + suffix for axis in "xy"}
    words = draw(st.sampled_from(SIDES_IN_WORDS))
    order = draw(st.permutations(["ref", "x", "y", "rotation", "side", "extra"]))
    extra = draw(st.lists(st.sampled_from(["10k", "100 nF", "SO 8", "HDR .1"]), min_size=len(refs), max_size=len(refs)))

    def number(value: float) -> str:
        return f"{value:.2f}".replace(".", "," if comma else ".")

    rows = [[names[role] for role in order]]
    for (ref, (side, x, y, turn)), value in zip(truth.items(), extra, strict=True):
        cells = {"ref": ref, "x": number(x) + unit, "y": number(y) + unit, "rotation": str(turn), "extra": value}
        cells["side"] = words[side == "bottom"]
        rows.append([cells[role] for role in order])
    widths = [max(len(row[n]) for row in rows) + 2 for n in range(len(order))]
    if delimiter in ("left", "right"):
        lines = [
            "".join(f"{c:{'<' if delimiter == 'left' else '>'}{w}}" for c, w in zip(r, widths, strict=True))
            for r in rows
        ]
    else:
        lines = [delimiter.join(row) for row in rows]
    design = read("\n".join(lines), **({} if suffix or unit else {"units": "mm"}))
    assert placed(design) == truth
