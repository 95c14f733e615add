from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.board_data.readers.table_columns import is_known_header, is_ref_header
from vaoi_station.board_data.readers.table_lines import delimited, fixed_width, spaced, split_lines


@pytest.mark.parametrize(
    ("text", "cells"),
    [
        ('R1,"10k, 1%",5', ("R1", "10k, 1%", "5")),
        ('R1,"a ""b"" c",5', ("R1", 'a "b" c', "5")),
        ('R1,"HEADER .05"",5', ("R1", 'HEADER .05"', "5")),
        ('R1,"HEADER .1" 8 way",5', ("R1", 'HEADER .1" 8 way', "5")),
        ('R1,HEADER .1" 8 way,5', ("R1", 'HEADER .1" 8 way', "5")),
        ('R1, "10k" ,5', ("R1", "10k", "5")),
        ('R1,"10k\n1%",5', ("R1", "10k 1%", "5")),
        ('R1,"10k\n\n\n1%",5', ("R1", "10k 1%", "5")),
        ('R1,"open,5', ("R1", '"open', "5")),
    ],
)
def test_quotation_marks_enclose_cells_or_are_inch_marks(text: str, cells: tuple[str, ...]) -> None:
    lines = ["a,b,c", *text.split("\n"), "R9,x,1", "R8,y,2"]
    records = delimited(lines, ",")
    assert [r.cells for r in records][1:] == [cells, ("R9", "x", "1"), ("R8", "y", "2")]
    assert sum(r.lines for r in records) == len(lines)
    assert [lines[r.line - 1].split("\n")[0] for r in records] == [r.text.split("\n")[0] for r in records]


HEADER = "Ref    Mid X   Mid Y  Pad Y TB Comment"
ROWS = {
    "set to the left": ["R1     10      20.5   21    T  10k 1%", "C100   1000.5  2      2     B  "],
    "set to the right": ["R1        10    20.5    21  T 10k 1%", "C100  1000.5       2     2  B "],
}


@pytest.mark.parametrize("way", ROWS)
def test_columns_are_cut_at_the_words_of_the_header(way: str) -> None:
    records = fixed_width([HEADER, "", *ROWS[way]], 0, is_known_header, is_ref_header)
    assert records is not None
    assert records[0].cells == ("Ref", "Mid X", "Mid Y", "Pad Y", "TB", "Comment")
    assert records[2].cells == ("R1", "10", "20.5", "21", "T", "10k 1%")
    assert records[3].cells == ("C100", "1000.5", "2", "2", "B", "")


def test_a_line_whose_words_lie_across_columns_is_marked() -> None:
    rows = [f"R{n}     10      20.5   21    T  10k" for n in range(8)]
    records = fixed_width([HEADER, *rows, "R9     1000000020000021    T  10k"], 0, is_known_header, is_ref_header)
    assert records is not None
    assert [r.cut for r in records] == [False] * 9 + [True]


def test_lines_without_fixed_columns_are_no_such_table() -> None:
    assert fixed_width(["Ref X Y Comment", "R1 10 20 a", "C100 1000 2000 b"], 0, is_known_header, is_ref_header) is None


def test_cells_at_spaces() -> None:
    assert spaced(['R1 "10 k"  5'])[0].cells == ("R1", "10 k", "5")


def test_only_line_ends_end_a_line() -> None:
    assert split_lines("a\r\nb\rc\x0cd\u2028e\n") == ["a", "b", "c\x0cd\u2028e"]


@given(st.lists(st.text(alphabet='ab"\n,; 1', max_size=12), max_size=8))
def test_every_line_is_part_of_one_record(cells: list[str]) -> None:
    lines = split_lines(",".join(cells))
    records = delimited(lines, ",")
    assert [r.line for r in records] == [1 + sum(r.lines for r in records[:n]) for n in range(len(records))]
    assert sum(r.lines for r in records) == len(lines)
