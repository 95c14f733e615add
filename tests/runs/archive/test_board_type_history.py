"""Versions of board types for callers: listed, read, and put in force again."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.runs.archive.board_type_history import BoardTypeHistory
from vaoi_station.store import BoardTypeDirectory


def board(x: float) -> BoardType:
    return BoardType(name="b", fiducials=(Fiducial(name="F", x=x, y=0, diameter=1),))


@pytest.fixture
def directory(tmp_path: Path) -> BoardTypeDirectory:
    return BoardTypeDirectory(tmp_path)


def test_a_deleted_board_type_is_restored(directory: BoardTypeDirectory) -> None:
    sources: list[str] = []

    def put(board_type: BoardType, source: str) -> bool:
        sources.append(source)
        return directory.put(board_type)

    returned: list[str] = []
    history = BoardTypeHistory(directory, put, returned.append)
    directory.put(board(1))
    directory.put(board(2))
    directory.delete("b")
    assert history.deleted() == ("b",)
    found = {history.get("b", version.id).fiducials[0].x: version for version in history.list("b")}
    assert found.keys() == {1, 2}
    assert found[1].stored <= found[1].ended
    assert history.restore("b", found[1].id) == board(1) == directory.get("b")
    assert sources == [f" by its version {found[1].id}"]
    assert history.deleted() == ()
    assert returned == ["b"]
    history.restore("b", "latest")
    assert returned == ["b"], "it was there"
    with pytest.raises(NotFoundError):
        history.list("other")
