from __future__ import annotations

import pytest

from vaoi_station.board_data.readers.odb_packages import OdbFile, Package, Toeprint, packages_of, readings, toeprint_of

LINES = """UNITS=MM
PKG SOT 1 -1.5 -1.4 1.5 1.4;
RC -1.5 -0.65 3 1.3
PIN A S -0.95 -1.1 0 U U
RC -1.25 -1.4 0.6 0.8
PIN B S 0.95 nan 0 U U
PKG BARE 1 -1 -2 3 2;
PIN 1 T 0 0 0 U U
"""


def test_outline_pads_and_pins_of_packages_are_read() -> None:
    sot, bare = packages_of(OdbFile("eda/data", LINES.splitlines(), None))
    assert (sot.name, sot.pins) == ("SOT", [("A", (-0.95, -1.1)), ("B", None)])
    assert sot.pad == pytest.approx(0.8)
    assert sot.points == [(-1.5, -0.65), (1.5, 0.65)]
    # Without an outline it is the bounding box of the line PKG.
    assert bare.points == [(-1, -2), (3, 2)]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("TOP 3 1 2 90 N 4 5 A1 ;0=1", Toeprint(3, "A1", (25.4, 50.8))),
        ("TOP 3 1 2 90 N 4 5", Toeprint(3, "", (25.4, 50.8))),
        ("TOP 3 1", None),
        ("TOP 3 1 inf 90 N 4 5 A1", None),
        ("TOP -1 1 2 90 N 4 5 A1", None),
        ("TOP 1.5 1 2 90 N 4 5 A1", None),
    ],
)
def test_a_toeprint_needs_a_pin_and_a_place(line: str, expected: Toeprint | None) -> None:
    assert toeprint_of(line, 25.4) == expected


def test_pins_are_found_by_number_from_0_by_name_and_by_number_from_1() -> None:
    package = Package("P", pins=[("A", (1, 0)), ("B", (2, 0)), ("A", (3, 0))])
    found = readings(package, [Toeprint(1, "A", (0, 0))])
    assert [pins[0].drawn for pins in found] == [(2, 0), (1, 0), (1, 0)]
    assert [pins[0].drawn for pins in readings(package, [Toeprint(9, "Z", (0, 0))])] == [None, None, None]
