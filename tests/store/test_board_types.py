"""Board types as files."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.store import BoardTypeDirectory


@pytest.fixture
def directory(tmp_path: Path) -> BoardTypeDirectory:
    return BoardTypeDirectory(tmp_path / "board-types")


def board(name: str) -> BoardType:
    return BoardType(name=name, fiducials=(Fiducial(name="F", x=0, y=0, diameter=1),))


def test_taught_read_replaced_forgotten(directory: BoardTypeDirectory) -> None:
    assert directory.list() == []
    assert directory.put(board("A 1")) is True
    changed = board("A 1").model_copy(update={"side": "bottom"})
    assert directory.put(changed) is False
    assert directory.get("A 1") == changed
    assert (directory.directory / "A 1.json").is_file()
    directory.delete("A 1")
    with pytest.raises(NotFoundError, match="taught are: none yet"):
        directory.get("A 1")
    with pytest.raises(NotFoundError):
        directory.delete("A 1")


@settings(max_examples=60)
@given(st.text(min_size=1, max_size=40).filter(lambda s: s.isprintable()))
def test_any_name_has_a_file_of_its_own_inside_the_directory(name: str) -> None:
    directory = BoardTypeDirectory(Path("/somewhere"))
    path = directory.path_of(name)
    assert path.parent == Path("/somewhere")
    assert not path.name.startswith(".")
    assert path.name.isascii()
    assert directory.path_of(name + "x") != path


@pytest.mark.parametrize("name", ["../escape", "a/b", "..", ".hidden", "ü/%2F", "C:\\x"])
def test_names_that_file_systems_mind(directory: BoardTypeDirectory, name: str) -> None:
    directory.put(board(name))
    assert directory.get(name).name == name
    assert [entry.path.parent for entry in directory.list()] == [directory.directory]


def test_a_name_too_long_for_a_file(directory: BoardTypeDirectory) -> None:
    with pytest.raises(InputError, match="name is"):
        directory.put(board("ü" * 200))


def test_files_that_cannot_be_used_are_listed_with_their_fault(directory: BoardTypeDirectory) -> None:
    directory.put(board("good"))
    (directory.directory / "good.json").rename(directory.directory / "renamed.json")
    directory.put(board("good"))
    (directory.directory / "broken.json").write_text('{"name": "broken", "nmae": 1}')
    faults = {entry.path.stem: entry.fault.message if entry.fault else None for entry in directory.list()}
    assert faults["good"] is None
    assert "holds the board type 'good'" in str(faults["renamed"])
    assert "unknown key(s) 'nmae'" in str(faults["broken"])
    with pytest.raises(InputError, match="nmae"):
        directory.get("broken")
