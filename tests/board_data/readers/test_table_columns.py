from __future__ import annotations

import pytest

from vaoi_station.board_data.readers.table_columns import (
    angle_in,
    columns_by_header,
    decimal_separator,
    is_fitted,
    is_known_header,
    named_columns,
    number_in,
    plain_key,
    sides_of,
)


def test_headers_are_compared_without_unit_case_and_punctuation() -> None:
    keys = ["Center-X(mm)", "X [mil]", "PosX mm", "Gehäuse", "Ref. Des.", "Bestückungsseite", "Winkel in °"]
    assert list(map(plain_key, keys)) == ["centerx", "x", "posx", "gehaeuse", "refdes", "bestueckungsseite", "winkel"]
    assert [is_known_header(words) for words in ("Mid X", "Pad Y", "Pad Y TB")] == [True, True, False]


@pytest.mark.parametrize(
    ("header", "chosen"),
    [
        (["Ref X", "Ref Y", "Mid X", "Mid Y"], (2, 3)),
        (["Position X", "Position Y", "Place X", "Place Y"], (2, 3)),
        (["X", "Y", "Pad X", "Pad Y"], (0, 1)),
        (["Part X", "Part Y", "Part Center X", "Part Center Y"], (2, 3)),
        (["Y-Koordinate", "X-Koordinate", "Size X", "Size Y"], (1, 0)),
        (["Center X", "Ref Y", "Ref X", "Center Y"], (0, 3)),
    ],
)
def test_both_axes_are_those_of_the_centre_where_there_are_several(header: list[str], chosen: tuple[int, int]) -> None:
    found = columns_by_header(header, [["1"] * len(header)])
    assert (found["x"], found["y"]) == chosen


def test_the_place_of_a_pad_is_none_of_the_part() -> None:
    assert "x" not in named_columns(["Designator", "Pad X", "Pad Y"])


@pytest.mark.parametrize(
    ("header", "rows", "column"),
    [
        (["Name", "Part"], [["R1", "RES10K"], ["R2", "RES1K"]], 0),
        (["Part", "Name"], [["R1", "RES10K"], ["R2", "RES1K"]], 0),
        (["Component", "Designator"], [["C0402", "C1"], ["C0402", "C2"]], 1),
        (["Designator", "Part"], [["Mechanical", "X"], ["Bracket", "Y"]], 0),
        (["Teil", "Wert"], [["R1", "10k"], ["U7", "LM358"]], 0),
        (["Reference", "ID"], [["IC1", "1"], ["K7", "2"]], 0),
    ],
)
def test_the_designators_are_chosen_by_their_values(header: list[str], rows: list[list[str]], column: int) -> None:
    assert columns_by_header(header, rows)["ref"] == column


def test_numbers_have_a_decimal_comma_or_separate_thousands() -> None:
    cells = ("1,5", "-.5e1", "2 mm", "90°", "1.2.3", "1e400", "−3", "1,000.5", "1.000,5", "1'000.5", "1,234")
    assert [number_in(cell) for cell in cells] == [
        1.5, -5.0, 2.0, 90.0, None, None, -3.0, 1000.5, 1000.5, 1000.5, 1.234,
    ]  # fmt: skip
    assert decimal_separator(["1,234", "1.5"]) == "."
    assert decimal_separator(["1.234", "12,5"]) == ","
    assert (number_in("1,234", "."), number_in("1.234", ",")) == (1234, 1234)
    assert decimal_separator(["1,234", "5"]) is None
    assert decimal_separator(["12,5", "0.5"]) is None


def test_angles_may_be_those_of_eagle() -> None:
    assert [angle_in(cell) for cell in ("R90", "MR180", "SMR45.5", "-90", "x")] == [90, 180, 45.5, -90, None]


@pytest.mark.parametrize(
    ("header", "top", "bottom"),
    [
        ("Layer", ["TopLayer", "F.Cu", "Copper Top", "Front"], ["BottomLayer", "B.Cu", "Copper Bottom", "Back"]),
        ("Seite", ["Oben", "Oben (Bestückungsseite)", "BS"], ["Unten", "Rückseite", "LS"]),
        ("Side", ["T"], ["B"]),
        ("Side", ["A"], ["b"]),
        ("Seite", ["B"], ["L"]),
        ("Side", ["U"], ["L"]),
        ("Seite", ["O"], ["U"]),
        ("Side", ["1"], ["2"]),
        ("Layer", ["1"], ["16"]),
        ("Layer", ["0"], ["31"]),
        ("Layer", ["L1"], ["L4"]),
        ("Side (1=Top, 0=Bottom)", ["1"], ["0"]),
        ("Mirror", ["no", "0", "", "-", "F"], ["YES", "1", "m", "Mirror", "T"]),
        ("Unterseite", ["nein", ""], ["ja", "x"]),
        ("Top side", ["Yes", "X"], ["No", ""]),
    ],
)
def test_sides_are_words_letters_or_numbers(header: str, top: list[str], bottom: list[str]) -> None:
    expected = dict.fromkeys(top, "top") | dict.fromkeys(bottom, "bottom")
    assert sides_of([*top, *bottom], header) == expected


@pytest.mark.parametrize(
    "values", [["1"], ["0"], ["1", "2", "3"], ["L"], ["left", "right"], ["U", "B"], ["top bottom"]]
)
def test_what_may_be_either_side_is_none(values: list[str]) -> None:
    assert not sides_of(values, "Side")


def test_signs_of_fitting() -> None:
    assert (is_fitted("x", "D.N.P.", ()), is_fitted("x", "Fitted", ())) == (False, True)
    assert [is_fitted("", "", cells) for cells in (("SMD", "DNP"), ("nicht bestückt",), ("SMD",))] == [
        False,
        False,
        True,
    ]
