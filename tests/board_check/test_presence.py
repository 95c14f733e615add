"""Which components look as if they were there."""

from __future__ import annotations

import numpy as np

from vaoi_station.board_check.body_edges import BodyEdges
from vaoi_station.board_check.presence import shares_weaker
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.model import BoardType


def test_components_that_are_there_have_stronger_edges_than_other_places(run: CheckedRun, board: BoardType) -> None:
    c = np.array(run.stitch.cad_matrix)
    parts = list(board.components)
    parts[0] = parts[0].model_copy(update={"center": (70.0, 18.0)})
    parts[1] = parts[1].model_copy(update={"center": (25.0, 1.0), "width": 1.0, "height": 0.6, "rotation": 0.0})
    shares = shares_weaker(run.overview, BodyEdges.of(board.model_copy(update={"components": tuple(parts)})), c)
    assert np.isnan(shares[0]), "beyond the picture"
    assert shares[1] < 0.8
    assert np.median(shares[2:]) > 0.9
    assert (shares[2:] > 0.5).mean() > 0.9
