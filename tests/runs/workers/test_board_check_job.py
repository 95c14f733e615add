"""The check of a board type as a worker performs it."""

from __future__ import annotations

import pickle

import numpy as np

from tests.board_check.conftest import drawn_board, drawn_run
from vaoi_station.files.images import decode
from vaoi_station.runs.workers.board_check_job import BoardCheckJob
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.worker import Queued


def test_a_job_can_be_sent_and_yields_report_and_picture() -> None:
    board = drawn_board(count=12)
    run = drawn_run(board)
    job = BoardCheckJob("r1", 0, 1, {(0, 0): 5}, run.stitch, run.cameras, (), board, board)
    sent: BoardCheckJob = pickle.loads(pickle.dumps(job))
    assert sent.priority is Priority.HEIGHTS
    assert (Queued(sent).repeatable, Queued(sent).longest_s) == (False, 180.0)
    assert str(sent) == "the check of board type 'drawn' against run r1"
    slots: list[int] = []

    def frame(slot: int) -> np.ndarray:
        slots.append(slot)
        pixels = run.frame(0, 0)
        assert pixels is not None
        return pixels

    found = sent.perform(frame)
    assert set(slots) == {5}
    assert found.report.residual is not None
    assert found.report.proposal is None
    picture = decode(found.picture)
    assert picture is not None
    assert picture.ndim == 3
