"""A database in a temporary directory, and runs in it."""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from vaoi_station.store import Database, RunRow, Store

NOW = "2026-01-01T00:00:00Z"


def noise(size: int) -> str:
    """Return a text that takes `size` bytes in the database; it cannot be packed."""
    return random.Random(0).randbytes(size).decode("latin-1")


@contextmanager
def unreachable(directory: Path) -> Iterator[None]:
    """Let no file of a directory be found during a `with` block; files that are open stay usable."""
    user, mode = os.geteuid(), directory.stat().st_mode
    directory.chmod(0)
    try:
        if user == 0:
            os.seteuid(65534)  # root may search every directory
        yield
    finally:
        os.seteuid(user)
        directory.chmod(mode)


MakeRun = Callable[..., RunRow]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "data" / "station.db"


@pytest.fixture
def database(path: Path) -> Iterator[Database]:
    opened = Database(path)
    yield opened
    opened.close()


@pytest.fixture
def store(database: Database) -> Store:
    return Store(database)


@pytest.fixture
def make_run(store: Store) -> MakeRun:
    """Build a run whose board type and calibration are stored already."""

    def make(
        run: str, state: str = "filming", finish_number: int | None = None, calibration: str | None = None
    ) -> RunRow:
        board_type = store.keep_document("board-type", '{"name": "b"}', NOW)
        digest = store.keep_document("calibration", '{"n": 1}', NOW) if calibration is None else calibration
        return RunRow(run, state, finish_number, board_type, digest, '{"s": 1}', '{"d": 1}')

    return make
