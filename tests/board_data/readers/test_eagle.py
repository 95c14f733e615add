from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.readers.eagle import read_eagle
from vaoi_station.errors import InputError


def test_its_own_document_type_is_accepted_and_any_other_is_not() -> None:
    assert len(read_eagle(samples.EAGLE.encode(), Path("b.brd")).parts) == 4
    bomb = samples.EAGLE.replace('SYSTEM "eagle.dtd"', '[<!ENTITY a "aaa">]')
    with pytest.raises(InputError, match="declares a document type"):
        read_eagle(bomb.encode(), Path("b.brd"))


def test_mirrored_parts_turn_the_other_way() -> None:
    parts = {p.ref: p for p in read_eagle(samples.EAGLE.encode(), Path("b.brd")).parts}
    assert (parts["C1"].side, parts["C1"].rotation) == ("bottom", 90)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [("<board>", "<schematic>", "not valid XML"), ('x="10"', 'x="ten"', "element R1 x is 'ten', but must be a number")],
)
def test_wrong_files_are_refused(before: str, after: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_eagle(samples.EAGLE.replace(before, after).encode(), Path("b.brd"))
    with pytest.raises(InputError, match="has no <board>"):
        read_eagle(b"<eagle><drawing/></eagle>", Path("b.lbr"))
