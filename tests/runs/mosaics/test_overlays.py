"""What is drawn over a board, from a result with and without its tables."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.mosaic.conftest import Filmed, board, film
from tests.runs.finished import held_run
from vaoi_station.files.results import stitch_text
from vaoi_station.model import FrameRecord, Verdict
from vaoi_station.runs.mosaics.overlays import overlay_of

__all__ = ["board", "film"]


def finished(board: Filmed, **quality: Any) -> Any:
    stitch = board.stitch.model_copy(update={"quality": quality})
    frames = tuple(FrameRecord(camera=f.camera, row=f.row, verdict=Verdict.OK) for f in board.taken)
    detail, document = SimpleNamespace(frames=frames), stitch_text(stitch)
    return held_run(
        detail=detail, board_type=board.board_type, cameras=board.cameras, stitch=stitch, document=document
    )  # fmt: skip


def test_places_of_links_go_through_the_inverse_of_c(board: Filmed) -> None:
    cad = np.array(board.board_type.extent()).mean(0)
    matrix = np.array(board.stitch.cad_matrix)
    at = (matrix @ (*cad, 1))[:2].tolist()
    pair = {"a": [0, 0], "b": [0, 1], "found": 9, "used": 8, "at_mm": at, "residual_px": [0.3, 0.4], "rms_px": 0.6}
    unused = pair | {"used": 0, "at_mm": None, "residual_px": None, "rms_px": None}
    found = overlay_of(finished(board, link_pairs=[pair, unused]))
    used, without = found.links
    assert used.at == pytest.approx(tuple(cad), abs=1e-5)
    assert used.residual is not None
    back = matrix[:2, :2] @ used.residual * found.px_per_mm
    assert back.tolist() == pytest.approx([0.3, 0.4], abs=1e-4)
    assert (used.residual_px, without.at, without.residual_px) == (0.5, None, None)
