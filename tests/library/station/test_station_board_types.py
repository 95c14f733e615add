"""The board types of a station over a real socket: read, changed under a condition, taught."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import vaoi_station as vaoi
from tests.api.conftest import Served
from tests.api.held_station import HeldStation


@pytest.fixture
def board_types() -> Iterator[vaoi.StationBoardTypes]:
    station = HeldStation()
    station.film()
    served = Served(station)
    yield vaoi.connect(served.url).board_types
    served.stop()


def test_a_change_with_the_tag_of_an_earlier_version_is_refused(board_types: vaoi.StationBoardTypes) -> None:
    board, tag = board_types.get_tagged("demo-board")
    changed = board.model_copy(update={"revision": "B"})
    assert board_types.put(changed, tag=tag).revision == "B"
    with pytest.raises(vaoi.VaoiError) as refusal:
        board_types.put(board, tag=tag)
    assert refusal.value.code == "changed"
    with pytest.raises(vaoi.VaoiError) as refusal:
        board_types.put(board, new=True)
    assert refusal.value.code == "changed"


def test_a_reference_is_taught_and_forgotten(board_types: vaoi.StationBoardTypes) -> None:
    assert board_types.reference("demo-board") is None
    assert board_types.teach("demo-board", "r000001").run == "r000001"
    board_types.forget_reference("demo-board")
    with pytest.raises(vaoi.NotFoundError):
        board_types.reference("unheard")


def test_a_wrong_name_is_refused_before_a_request(board_types: vaoi.StationBoardTypes) -> None:
    with pytest.raises(vaoi.InputError, match="get: name is ''"):
        board_types.get("")
