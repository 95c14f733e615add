from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.board_data.readers.table_columns import (
    cells_of,
    find_delimiter,
    find_layout,
    is_fitted,
    number_in,
    plain_key,
)
from vaoi_station.errors import InputError

LINES = ["# made by a program", "ref;x (mm);Mid-Y [mm];a", "R1;1,5;2;3;10k"]


def test_the_delimiter_is_the_one_that_makes_a_header() -> None:
    assert find_delimiter(LINES) == ";"
    assert find_delimiter(["R1 1 2 90", "R2 3 4 0"]) == " "
    assert cells_of('R1 "10 k" 5', " ") == ["R1", "10 k", "5"]


def test_columns_are_found_in_the_header_and_given_by_number_or_header() -> None:
    rows = [cells_of(line, ";") for line in LINES]
    layout = find_layout(rows, Path("f"), (("rotation", "A"), ("value", "5")))
    assert layout.columns == {"ref": 0, "x": 1, "y": 2, "rotation": 3, "value": 4}
    assert (layout.first, layout.header_of("y"), layout.header_of("value")) == (2, "Mid-Y [mm]", "")
    for number in ("0", "6"):
        with pytest.raises(InputError, match=f"--columns value is '{number}', but must be a number from 1 to 5, or a"):
            find_layout(rows, Path("f"), (("value", number),))


def test_cells_are_numbers_words_and_signs_of_fitting() -> None:
    assert [number_in(cell) for cell in ("1,5", "-.5e1", "2 mm", "90°", "1.2.3", "1e400")] == [
        1.5,
        -5.0,
        2.0,
        90.0,
        None,
        None,
    ]
    assert plain_key("Center-X(mm)") == "centerx"
    assert (is_fitted("x", "D.N.P.", ""), is_fitted("x", "Fitted", "")) == (False, True)
