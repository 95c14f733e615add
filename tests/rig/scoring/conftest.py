from __future__ import annotations

from pathlib import Path

import pytest

from tests.rig.known_boards import known_board
from vaoi_station.rig.rendering import RenderedBoard


@pytest.fixture
def known(tmp_path: Path) -> RenderedBoard:
    """A board of two cameras and six rows."""
    return known_board(tmp_path / "board")
