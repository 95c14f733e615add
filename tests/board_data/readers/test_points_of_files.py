"""Pads and vias that a probe reaches are read from every format that has them, and formats agree about a board."""

# ruff: noqa: E501  (lines of the formats)

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from tests import needs
from vaoi_station.board_data import read_design, to_board_type
from vaoi_station.board_data.design import NetPoint
from vaoi_station.board_data.panels import Grid
from vaoi_station.board_data.readers.ipc_d356 import read_ipc_d356
from vaoi_station.board_data.reading import Options

KICAD = """(kicad_pcb (version 20241229) (setup (pcbplotparams (viasonmask false))) (net 0 "") (net 1 "GND") (net 2 "3V3")
(footprint "R" (layer "F.Cu") (at 10 -10 90) (property "Reference" "R1")
 (pad "1" smd rect (at -1 0) (size 0.8 1) (layers "F.Cu" "F.Mask") (net 1 "GND"))
 (pad "2" smd rect (at 1 0) (size 0.8 1) (layers "F.Cu" "F.Paste") (net 2 "3V3"))
 (pad "" smd rect (at 1 0) (size 0.5 0.5) (layers "F.Paste")))
(footprint "J" (layer "B.Cu") (at 30 -20) (property "Reference" "J1")
 (pad "1" thru_hole circle (at 0 0) (size 1.6 1.6) (drill 1) (layers "*.Cu" "*.Mask") (net 2 "3V3"))
 (pad "" np_thru_hole circle (at 3 0) (size 1 1) (layers "*.Cu" "*.Mask")))
(via (at 5 -5) (size 0.6) (drill 0.3) (layers "F.Cu" "B.Cu") (net 1))
(via (at 6 -5) (size 0.6) (drill 0.3) (layers "F.Cu" "B.Cu") (tenting back) (net 1))
(via (at 7 -5) (size 0.5) (drill 0.3) (layers "F.Cu" "In1.Cu") (tenting none) (net 2))
(gr_rect (start 0 0) (end 40 -30) (layer "Edge.Cuts")))"""
GENCAD = """$HEADER\nGENCAD 1.4\nUNITS MM\n$ENDHEADER
$PADS\nPAD P ROUND 0\nCIRCLE 0 0 0.4\nPAD Q ROUND 0\nCIRCLE 0 0 0.8\n$ENDPADS
$PADSTACKS\nPADSTACK S 0\nPAD P TOP 0 0\nPAD P SOLDERMASK_TOP 0 0\nPADSTACK T 1\nPAD Q TOP 0 0\nPAD Q BOTTOM 0 0
PADSTACK V 0.3\nPAD P TOP 0 0\nPAD P BOTTOM 0 0\nPADSTACK O 0.3\nPAD P TOP 0 0\nPAD P BOTTOM 0 0\nPAD P SOLDERMASK_BOTTOM 0 0\n$ENDPADSTACKS
$SHAPES\nSHAPE R\nPIN 1 S -1 0 TOP 0 0\nPIN 2 P 1 0 TOP 0 0\nPIN 2 P 1 0 BOTTOM 0 0\nSHAPE J\nPIN 1 T 0 0 TOP 0 0\n$ENDSHAPES
$COMPONENTS\nCOMPONENT R1\nPLACE 10 10\nLAYER TOP\nROTATION 90\nSHAPE R 0 0\nCOMPONENT J1\nPLACE 30 20\nLAYER BOTTOM\nROTATION 0\nSHAPE J MIRRORX FLIP\n$ENDCOMPONENTS
$SIGNALS\nSIGNAL GND\nNODE R1 1\nSIGNAL 3V3\nNODE J1 1\n$ENDSIGNALS
$ROUTES\nROUTE GND\nVIA V 5 5 ALL 0.3 v1\nVIA O 6 5 ALL 0.3 v2\nTESTPAD S 20 5 0 0 TP9\n$ENDROUTES
$TESTPINS\nTESTPIN 1 -32767 -32767 -1 -1 -1 -1 TOP\nTESTPIN N7 8 8 GND -1 -1 -1 BOTTOM\n$ENDTESTPINS
"""
IPC2581 = """<IPC-2581><Ecad><CadHeader units="MILLIMETER"/><CadData>
<Layer name="F" layerFunction="CONDUCTOR" side="TOP"/><Layer name="B" layerFunction="CONDUCTOR" side="BOTTOM"/><Layer name="M" layerFunction="SOLDERMASK" side="TOP"/>
<Step name="pcb"><Component refDes="R1" packageRef="R" layerRef="F"><Location x="10" y="10"/></Component>
<LayerFeature layerRef="F"><Set net="GND"><Pad><Location x="10" y="9"/><Circle diameter="0.8"/><PinRef componentRef="R1" pin="1"/></Pad>
<Pad><Location x="30" y="20"/><PinRef componentRef="CMP:J1" pin="PIN:1"/></Pad></Set>
<Set net="NET:GND" padUsage="VIA"><Pad><Location x="5" y="5"/></Pad><Pad><Location x="6" y="5"/></Pad></Set></LayerFeature>
<LayerFeature layerRef="B"><Set net="GND"><Pad><Location x="30" y="20"/><PinRef componentRef="J1" pin="1"/></Pad><Pad><Location x="1" y="1"/></Pad><Pad><Location x="7" y="nowhere"/></Pad></Set></LayerFeature>
<LayerFeature layerRef="M"><Set><Pad><Location x="10" y="9"/></Pad><Pad><Location x="30" y="20"/></Pad><Pad><Location x="6.004" y="5"/></Pad></Set></LayerFeature>
</Step></CadData></Ecad></IPC-2581>"""
_LAYER = "LAYER {{\nROW={}\nCONTEXT=BOARD\nTYPE={}\nNAME={}\n}}\n"
ODB = {
    "matrix/matrix": "".join(_LAYER.format(n, *of) for n, of in enumerate((("SOLDER_MASK", "SMT"), ("SIGNAL", "TOP"), ("SIGNAL", "BOT")), 1)),
    "steps/pcb/layers/comp_+_top/components": "UNITS=MM\nCMP 0 10 10 0 N R1 10k\nTOP 0 10 9 0 N 1 0 1\nTOP 1 10 11 0 N 0 0 2\nCMP 0 30 20 0 N J1 x\nTOP 0 30 20 0 N 1 0 1\n",
    "steps/pcb/eda/data": "UNITS=MM\nLYR smt top bot\nNET $NONE$\nSNT TOP T 0 1\nFID C 0 4\nNET GND\nSNT TOP T 0 0\nFID C 1 0\nSNT TOP T 1 0\nFID C 1 1\nFID C 2 0\nSNT VIA\nFID C 1 3\nFID C 2 1\nSNT VIA\nFID C 1 4\nFID C 2 2\nPKG R 1 -1 -1 1 1;\n",
    "steps/pcb/layers/top/features": "UNITS=MM\n$0 rect800x1000\n$1 r1600\nP 10 9 0 P 0 0\nP 30 20 1 P 0 0\nS P 0\nOB 0 0 I\nOS 0 1\nOS 1 1\nOE\nSE\nP 5 5 1 P 0 0\nP 6 5 1 P 0 0\n",
    "steps/pcb/layers/bot/features": "UNITS=MM\n$0 r1600\nP 30 20 0 P 0 0\nP 5 5 0 P 0 0\nP 6 5 0 P 0 0\n",
    "steps/pcb/layers/smt/features": "UNITS=MM\n$0 r900\nP 10 9 0 P 0 0\nP 30 20 0 P 0 0\nP 6 5 0 P 0 0\n",
}  # fmt: skip


def points(folder: Path, name: str, content: bytes) -> dict[str, NetPoint]:
    (folder / name).write_bytes(content)
    return {point.name: point for point in read_design(folder / name).net_points}


def short(found: dict[str, NetPoint]) -> dict[str, tuple[object, ...]]:
    return {
        name: (*(round(v, 3) for v in p.at), p.net, p.kind, "T" * p.on_top + "B" * p.on_bottom, p.diameter)
        for name, p in found.items()
    }


def test_kicad_pads_by_their_layers_and_vias_that_are_not_tented(tmp_path: Path) -> None:
    assert short(points(tmp_path, "b.kicad_pcb", KICAD.encode())) == {
        "R1-1": (10, 9, "GND", "pad", "T", 0.8),
        "J1-1": (30, 20, "3V3", "pin", "TB", 1.6),
        "VIA GND#2": (6, 5, "GND", "via", "T", 0.6),
        "VIA 3V3": (7, 5, "3V3", "via", "T", 0.5),
    }
    usual = points(tmp_path, "o.kicad_pcb", KICAD.replace("viasonmask false", "viasonmask true").encode())
    assert (usual["VIA GND"].on_top, usual["VIA GND"].on_bottom) == (True, True)
    newest = points(
        tmp_path, "n.kicad_pcb", KICAD.replace("(tenting back)", "(tenting (front yes) (back no))").encode()
    )
    assert (newest["VIA GND#2"].on_top, newest["VIA GND#2"].on_bottom) == (False, True)


@pytest.mark.parametrize(("front", "inner", "back"), [(0, 1, 31), (15, 1, 0)])
def test_kicad_copper_layers_that_the_user_has_named(tmp_path: Path, front: int, inner: int, back: int) -> None:
    usual = points(tmp_path, "b.kicad_pcb", KICAD.encode())
    named = KICAD.replace("F.Cu", "Top").replace('"B.Cu"', "C4B").replace('"In1.Cu"', "GND")
    table = f"(layers ({front} Top signal) ({inner} GND power) ({back} C4B signal hide) (36 B.SilkS user)) (net 0"
    assert points(tmp_path, "n.kicad_pcb", named.replace("(net 0", table, 1).encode()) == usual
    newest = KICAD.replace("(net 0", '(layers (0 "F.Cu" signal) (2 "B.Cu" signal) (4 "In1.Cu" signal "GND")) (net 0', 1)
    assert points(tmp_path, "v.kicad_pcb", newest.encode()) == usual
    sides = {part.ref: part.side for part in read_design(tmp_path / "n.kicad_pcb").parts}
    assert sides == {"R1": "top", "J1": "bottom"}


def test_kicad_copper_of_a_pad_may_lie_beside_its_place_but_not_beside_its_hole(tmp_path: Path) -> None:
    text = KICAD.replace("(at -1 0) (size 0.8 1)", "(at -1 0 180) (size 0.8 1) (drill (offset 0.3 0.1))")
    text = text.replace("(drill 1)", "(drill 1 (offset 0.3 0.1))")
    found = short(points(tmp_path, "b.kicad_pcb", text.encode()))
    # The pad is turned by 90° against its part, which is turned by 90°: its x is the -x of the board.
    assert found["R1-1"][:2] == (9.7, 9.1)
    assert found["J1-1"][:2] == (30, 20)


def test_gencad_pins_of_shapes_vias_test_pads_and_test_pins(tmp_path: Path) -> None:
    assert short(points(tmp_path, "b.cad", GENCAD.encode())) == {
        "R1-1": (10, 9, "GND", "pad", "T", 0.8),
        "R1-2": (10, 11, "", "pin", "TB", None),
        "J1-1": (30, 20, "3V3", "pin", "TB", 1.6),
        "VIA GND#2": (6, 5, "GND", "via", "B", 0.8),
        "TP9": (20, 5, "GND", "pad", "T", 0.8),
        "N7": (8, 8, "GND", "pad", "B", None),
    }
    (tmp_path / "u.cad").write_text(GENCAD.replace("SOLDERMASK_", "PASTE_"))
    assert "vias-mask-unknown" in [note.code for note in read_design(tmp_path / "u.cad").notes]
    without = read_design(tmp_path / "u.cad", Options(test_points=False))
    assert "vias-mask-unknown" not in [note.code for note in without.notes]


def test_gencad_stacks_of_a_shape_may_be_those_of_its_use_on_the_other_side(tmp_path: Path) -> None:
    below = GENCAD.replace("PAD P TOP 0 0\nPAD P SOLDERMASK_TOP", "PAD P BOTTOM 0 0\nPAD P SOLDERMASK_BOTTOM")
    below = below.replace("PIN 2 P 1 0 TOP 0 0\nPIN 2 P 1 0 BOTTOM 0 0\n", "PIN 2 S 1 0 TOP 0 0\n")
    found = short(points(tmp_path, "b.cad", below.encode()))
    assert [found[name][4] for name in ("R1-1", "R1-2", "J1-1")] == ["T", "T", "TB"]


@pytest.mark.parametrize(
    ("track", "sides", "notes"), [("LAYER TOP", "TB", 0), ("LAYER BOTTOM", "BT", 0), ("LAYER INNER1", "BT", 1)]
)
def test_gencad_tracks_show_the_side_of_the_pads_of_an_edge_connector(
    tmp_path: Path, track: str, sides: str, notes: int
) -> None:
    text = GENCAD.replace("PIN 2 P 1 0 TOP 0 0\nPIN 2 P 1 0 BOTTOM 0 0\n", "PIN 2 P -1 0 BOTTOM 0 0\n")
    text = text.replace("LAYER TOP\nROTATION 90\nSHAPE R 0 0", "LAYER BOTTOM\nROTATION 90\nSHAPE R MIRRORY FLIP")
    text = text.replace("LAYER BOTTOM\nROTATION 0\nSHAPE J MIRRORX FLIP", "LAYER TOP\nROTATION 0\nSHAPE J 0 0")
    text = text.replace("ROUTE GND\n", f"ROUTE GND\n{track}\nLINE 10 11 20 11\n")
    found = short(points(tmp_path, "b.cad", text.encode()))
    assert (found["R1-1"][:2], f"{found['R1-1'][4]}{found['R1-2'][4]}") == ((10, 11), sides)
    assert [n.code for n in read_design(tmp_path / "b.cad").notes].count("pad-sides-unclear") == notes


def test_ipc_2581_pads_of_pins_and_vias_where_mask_is_open(tmp_path: Path) -> None:
    found = short(points(tmp_path, "b.xml", IPC2581.encode()))
    assert found.keys() == {"R1-1", "J1-1", "VIA GND#2"}
    assert found["R1-1"] == (10, 9, "GND", "pad", "T", pytest.approx(0.8, abs=0.01))
    assert found["J1-1"][3:5] == ("pin", "TB")
    assert found["VIA GND#2"][4] == "T"
    negative = points(tmp_path, "d.xml", IPC2581.replace('diameter="0.8"', 'diameter="-0.8"').encode())
    assert negative["R1-1"].diameter is None
    (tmp_path / "u.xml").write_text(IPC2581.replace("SOLDERMASK", "SOLDERPASTE"))
    assert "vias-mask-unknown" in [note.code for note in read_design(tmp_path / "u.xml").notes]


def test_a_pad_in_an_opening_of_several_pads_stays_a_test_point_and_is_named(tmp_path: Path) -> None:
    pad = '<Pad><Location x="10" y="11"/><PinRef componentRef="R1" pin="2"/></Pad>'
    found = short(points(tmp_path, "b.xml", IPC2581.replace("<Pad>", f"{pad}<Pad>", 1).encode()))
    assert found["R1-2"][4] == "T"
    assert "VIA GND" not in found
    (note,) = (note for note in read_design(tmp_path / "b.xml").notes if note.code == "pads-without-opening")
    assert (note.values["count"], note.values["names"]) == ("1", "R1-2")


@pytest.mark.parametrize("name", ["b.xml", "b.zip"])
def test_a_layer_of_solder_mask_without_openings_says_nothing_of_the_vias(tmp_path: Path, name: str) -> None:
    (tmp_path / "b.xml").write_text(IPC2581.replace('<LayerFeature layerRef="M">', '<LayerFeature layerRef="other">'))
    with zipfile.ZipFile(tmp_path / "b.zip", "w") as archive:
        for file, text in ODB.items():
            archive.writestr(file, "UNITS=MM\n" if "/smt/" in file else text)
    notes = [note.values["sides"] for note in read_design(tmp_path / name).notes if note.code == "vias-mask-unknown"]
    assert notes == ["top" if name == "b.xml" else "top and bottom"]


def test_odb_toeprints_on_copper_and_vias_of_nets(tmp_path: Path) -> None:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        for name, text in ODB.items():
            archive.writestr(name, text)
    assert short(points(tmp_path, "b.zip", data.getvalue())) == {
        "R1-1": (10, 9, "GND", "pad", "T", 0.8),
        "J1-1": (30, 20, "GND", "pin", "TB", 1.6),
        "VIA GND": (5, 5, "GND", "via", "B", 1.6),
        "VIA GND#2": (6, 5, "GND", "via", "TB", 1.6),
    }


def test_points_of_a_side_are_in_its_board_type_and_on_a_panel_have_their_board_before_them(tmp_path: Path) -> None:
    (tmp_path / "b.kicad_pcb").write_text(KICAD)
    made, _ = to_board_type(read_design(tmp_path / "b.kicad_pcb"), "bottom")
    assert made.test_points is not None
    assert (made.test_points.name, made.test_points.kind, made.test_points.diameter) == (("J1-1",), ("pin",), (1.6,))
    panel, _ = to_board_type(read_design(tmp_path / "b.kicad_pcb", Options(grid=Grid((2, 1), (50.0, 0.0)))), "top")
    assert panel.test_points is not None
    assert [n for n in panel.test_points.name if "J1" in n] == ["1/J1-1", "2/J1-1"]
    assert panel.test_points.x[panel.test_points.name.index("2/J1-1")] == 80.0
    without = read_design(tmp_path / "b.kicad_pcb", Options(test_points=False))
    assert to_board_type(without, "top")[0].test_points is None


def test_a_pad_that_is_too_small_has_no_diameter(tmp_path: Path) -> None:
    (tmp_path / "b.kicad_pcb").write_text(KICAD.replace("(size 0.8 1)", "(size 0.00001 1)"))
    made, _ = to_board_type(read_design(tmp_path / "b.kicad_pcb"), "top")
    assert made.test_points is not None
    assert made.test_points.diameter is not None
    assert made.test_points.diameter[0] is None


def test_names_are_unique_and_without_control_characters(tmp_path: Path) -> None:
    text = KICAD.replace('(pad "2" smd', '(pad "1#2" smd').replace('"F.Paste") (net 2', '"F.Mask") (net 2')
    text = text.replace(
        '(pad "" smd rect (at 1 0) (size 0.5 0.5) (layers "F.Paste"))',
        '(pad "1" smd rect (at 1 0) (size 0.5 0.5) (layers "F.Cu" "F.Mask"))',
    )
    text = text.replace('"3V3"', '"3\\nV3"')
    found = points(tmp_path, "b.kicad_pcb", text.encode())
    assert [name for name in found if name.startswith("R1")] == ["R1-1", "R1-1#2", "R1-1#3"]
    assert "VIA 3 V3" in found
    assert to_board_type(read_design(tmp_path / "b.kicad_pcb"), "top")[0].test_points is not None


def test_allegro_states_where_mask_is_open(tmp_path: Path) -> None:
    record = "{}GND              {:<6}-{:<4}        {}X+016575Y+014083X0394Y0315     S{}\n"
    text = "P  UNITS CUST 0\n" + "".join(
        record.format(*of)
        for of in (("327", "R1", "1", "A01", 1), ("327", "R2", "1", "A04", 2), ("317", "VIA", "", "A00", 2), ("317", "J1", "1", "A00", 3))
    )  # fmt: skip
    found = {p.name: (p.on_top, p.on_bottom) for p in read_ipc_d356(text.encode(), tmp_path / "b.ipc")}
    assert found == {"R1-1": (True, False), "R2-1": (False, True), "VIA GND": (False, True), "J1-1": (True, True)}


@pytest.mark.parametrize(
    "name", ["orangecrab.kicad_pcb", "orangecrab.cad", "orangecrab.odb.zip", "breakout/odbjob.tgz"]
)
def test_points_are_those_of_the_netlist_of_the_same_board(name: str) -> None:
    needs.need_films()
    folder = needs.FILMS / "boards" / name.partition(".")[0].partition("/")[0]
    netlist = next(path for path in folder.iterdir() if path.suffix in (".d356", ".ipc"))
    expected = [p for p in read_ipc_d356(netlist.read_bytes(), netlist) if p.pin]
    found: dict[tuple[str, str], list[NetPoint]] = {}
    for point in read_design(folder / name.rpartition("/")[2]).net_points:
        found.setdefault((point.ref[:6], point.pin[:4]), []).append(point)
    shift = np.median(
        [np.subtract(p.at, found[p.ref, p.pin][0].at) for p in expected if len(found[p.ref, p.pin]) == 1], 0
    )
    off = [min(np.hypot(*(np.subtract(p.at, q.at) - shift)) for q in found[p.ref, p.pin]) for p in expected]
    assert len(expected) > 300
    # KiCad's ODB++ draws the pads of U9 as surfaces, whose middle is not the place of the pad.
    assert max(off) < (0.07 if name == "orangecrab.odb.zip" else 0.01)
