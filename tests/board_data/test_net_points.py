"""Test points of an IPC-D-356 netlist: read, laid on the board of another file, and kept in its board type."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.clamping.boards import filmed, request
from vaoi_station.board_data import read_design, to_board_type
from vaoi_station.board_data.readers.ipc_d356 import read_ipc_d356
from vaoi_station.clamping import Reading, clamp
from vaoi_station.errors import InputError
from vaoi_station.files.board_types import read_board_type, write_board_type

PLACES = {"R1": (10.0, 10.0), "R2": (30.0, 12.5), "R3": (22.0, 31.0), "LONGNAME1": (40.0, 25.0)}
SHIFT = (-3.2, 4.7)


def kicad() -> str:
    """Return a board with parts of two pads each, 2 mm apart along x, and two fiducials."""
    parts = "".join(
        f'(footprint "R_0805_2012Metric" (layer "F.Cu") (at {x} {-y}) (property "Reference" "{ref}")'
        '(pad "1" smd rect (at -1 0) (size 1 1.2)) (pad "2" smd rect (at 1 0) (size 1 1.2)))'
        for ref, (x, y) in PLACES.items()
    )
    marks = "".join(
        f'(footprint "Fiducial_1mm" (layer "F.Cu") (at {x} {-y}) (property "Reference" "FID{n}")'
        '(pad "" smd circle (at 0 0) (size 1 1)))'
        for n, (x, y) in enumerate(((2, 2), (48, 38)))
    )
    return f'(kicad_pcb (version 20240108) {parts}{marks}(gr_rect (start 0 0) (end 50 -40) (layer "Edge.Cuts")))'


def record(code: str, net: str, ref: str, pin: str, at: tuple[float, float], access: str, mask: int) -> str:
    """Return a record as KiCad writes it, in 0.0001 inch."""
    x, y = (round((c + s) / 0.00254) for c, s in zip(at, SHIFT, strict=True))
    dash = "-" if pin else " "
    return f"{code}{net:<14.14}   {ref:<6.6}{dash}{pin:<4}       {access}X{x:+07d}Y{y:+07d}X0394Y0472R000S{mask}"


def netlist(unit: str = "CUST 0") -> str:
    lines = ["P  CODE 00", f"P  UNITS {unit}", "P  NNAME1  A_VERY_LONG_NAME_OF_A_NET"]
    for ref, (x, y) in PLACES.items():
        lines += [record("327", "NNAME1", ref, "1", (x - 1, y), "A01", 2)]
        lines += [record("327", "GND", ref, "2", (x + 1, y), "A01", 2)]
    lines += [
        record("327", "GND", "C9", "1", (5.0, 5.0), "A04", 1),
        record("317", "GND", "VIA", "", (25.0, 20.0), "A00", 0),
        record("317", "GND", "VIA", "", (26.0, 20.0), "A00", 3),
        record("307", "GND", "VIA", "", (27.0, 20.0), "A02", 0),
    ]
    return "\n".join([*lines, "999"]) + "\n"


@pytest.fixture
def files(tmp_path: Path) -> tuple[Path, Path]:
    board, points = tmp_path / "b.kicad_pcb", tmp_path / "b.d356"
    board.write_text(kicad())
    points.write_text(netlist())
    return board, points


def test_points_of_the_side_are_laid_on_the_board_and_kept(files: tuple[Path, Path], tmp_path: Path) -> None:
    made, notes = to_board_type(read_design(files[0], join=files[1]), "top")
    write_board_type(tmp_path / "board.json", made)
    table = read_board_type(tmp_path / "board.json").test_points
    assert table is not None
    assert table.name == (*(f"{ref[:6]}-{pin}" for ref in PLACES for pin in "12"), "VIA GND")
    assert table.x[:2] == pytest.approx((9.0, 11.0), abs=3e-3)
    assert table.y[-1] == pytest.approx(20.0, abs=3e-3)
    assert table.net is not None
    assert table.net[:2] == ("A_VERY_LONG_NAME_OF_A_NET", "GND")
    assert [n.values["count"] for n in notes if n.code == "net-points-added"] == ["9"]


def test_a_clamped_board_is_probed_at_its_test_points_by_name(files: tuple[Path, Path]) -> None:
    made, _ = to_board_type(read_design(files[0], join=files[1]), "top")
    readings = tuple(Reading(fiducial=f.name, x=f.x + 100, y=f.y - 20) for f in made.fiducials)
    answer = clamp(filmed(made), request(readings, turn_deg=0.0, points=("R2-1", "R2")))
    assert [p.name for p in answer.points] == ["R2-1", "R2"]
    assert [v for p in answer.points for v in (p.x, p.y)] == pytest.approx([129.0, -7.5, 130.0, -7.5], abs=5e-3)


def test_the_bottom_is_the_highest_layer_and_masks_hide_points(files: tuple[Path, Path]) -> None:
    points = {p.name: p for p in read_ipc_d356(netlist().encode(), files[1])}
    assert (points["C9-1"].on_top, points["C9-1"].on_bottom) == (False, True)
    assert (points["VIA GND"].on_top, points["VIA GND"].on_bottom) == (True, True)
    assert "VIA GND#2" not in points, "mask covers it"
    assert "VIA GND#3" not in points, "it ends on an inner layer"


def test_millimetres_are_read(files: tuple[Path, Path]) -> None:
    metric = read_ipc_d356(netlist("CUST 1").encode(), files[1])
    assert metric[0].at[0] == pytest.approx(0.001 * round((9.0 + SHIFT[0]) / 0.00254))


def test_what_does_not_fit_is_refused_with_what_to_do(files: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="UNITS is 'FURLONG 0'"):
        read_ipc_d356(netlist("FURLONG 0").encode(), files[1])
    with pytest.raises(InputError, match="no point that a probe can reach"):
        read_ipc_d356(b"P  UNITS CUST 0\n999\n", files[1])
    other = tmp_path / "other.d356"
    other.write_text(netlist().replace("R1 ", "Q1 ").replace("R2 ", "Q2 "))
    with pytest.raises(InputError, match="fits 2 of 2 parts"):
        read_design(files[0], join=other)
