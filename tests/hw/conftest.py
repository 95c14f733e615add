"""The firmware two ways: its logic as a library of this computer, its binary on an emulated chip."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.hw.emulated.chip import Chip, make
from tests.hw.emulated.host import Host
from tests.hw.emulated.paced import PacedChip
from tests.needs import need, need_emulator


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("firmware")


@pytest.fixture(scope="session")
def logic(build: Path) -> ctypes.CDLL:
    """The logic of the firmware as a library of this computer; see native/bridge.h."""
    need("make", "gcc")
    make("native", build)
    return ctypes.CDLL(str(build / "liblogic.so"))


@pytest.fixture(scope="session")
def built(build: Path) -> Path:
    need_emulator()
    make("all", build)
    make("emulator", build)
    return build


@pytest.fixture
def chip(built: Path) -> Iterator[Chip]:
    """A chip that has just been powered and is listening."""
    chip = Chip(built)
    chip.run_ms(50)
    yield chip
    chip.close()


@pytest.fixture
def paced(built: Path, tmp_path: Path) -> Iterator[PacedChip]:
    """A chip at the pace of the clock, its serial line at `paced.link`."""
    chip = PacedChip(built, tmp_path / "vaoi-trigger")
    yield chip
    chip.close()


@pytest.fixture
def host(paced: PacedChip) -> Iterator[Host]:
    host = Host(paced)
    yield host
    host.controller.close()
