from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.readers.gencad import read_gencad
from vaoi_station.errors import InputError

PATH = Path("b.cad")


@pytest.mark.parametrize(
    ("units", "mm"),
    [("INCH", 25.4), ("THOU", 0.0254), ("MM", 1), ("MM100", 0.01), ("USER 1000", 0.0254), ("USERMM 5", 0.2)],
)
def test_units(units: str, mm: float) -> None:
    design = read_gencad(samples.GENCAD.replace("USER 1000", units).encode(), PATH)
    assert design.parts[0].origin[0] == pytest.approx(393.7008 * mm)


def test_components_without_a_place_are_named() -> None:
    assert any("X1" in note for note in read_gencad(samples.GENCAD.encode(), PATH).notes)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("UNITS USER 1000", "UNITS FURLONG", "b.cad, line 4: UNITS is 'FURLONG', but must be INCH, THOU"),
        ("UNITS USER 1000", "UNITS USER 0", "line 4: UNITS"),
        ("PLACE 393.7008 393.7008", "PLACE 393.7008", "line 32: 'PLACE 393.7008' must have 2 numbers after word 1"),
        ("PLACE 393.7008 393.7008", "PLACE here there", "must have 2 numbers"),
        ("$COMPONENTS", "$COMPONENTZ", r"has no section \$COMPONENTS"),
    ],
)
def test_wrong_files_are_refused(before: str, after: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_gencad(samples.GENCAD.replace(before, after).encode(), PATH)
