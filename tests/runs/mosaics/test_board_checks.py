"""Checks of board types are made once and kept."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from tests.runs.finished import held_run
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.errors import StateError
from vaoi_station.model import BoardType
from vaoi_station.runs.mosaics.board_checks import MOST_KEPT, BoardChecks
from vaoi_station.runs.workers.picture_jobs import BoardCheckJob, CheckedBoard

BOARD = BoardType.model_validate({"name": "b", "outline": [[0, 0], [9, 9]]})


class Line:
    """An archive of one run, and a worker that proposes a given board type."""

    def __init__(self, proposal: BoardType | None) -> None:
        self.proposal, self.jobs = proposal, list[BoardCheckJob]()
        frame = SimpleNamespace(camera=0, row=1, usable=True, slot=4)
        lost = SimpleNamespace(camera=0, row=0, usable=False, slot=3)
        self.finished = held_run(
            detail=SimpleNamespace(id="r1", frames=(lost, frame)),
            board_type=BOARD,
            cameras=(),
            stitch="stitch",
            head=SimpleNamespace(lights=("left",)),
        )
        archive: Any = SimpleNamespace(get=lambda _: self.finished)
        self.checks = BoardChecks(archive, self.lease, self.render)

    @contextmanager
    def lease(self, run: str, purpose: str) -> Iterator[Any]:
        yield SimpleNamespace(number=2, generation=7)

    def render(self, job: Any, name: str) -> CheckedBoard:
        self.jobs.append(job)
        report = BoardCheck(board_type=name, score=9, rival_score=5, components=3, measured=0, proposal=self.proposal)
        return CheckedBoard(report, b"jpeg")


def test_a_check_is_kept_until_the_board_type_changes() -> None:
    line = Line(None)
    assert line.checks.own_type("r1") == "b"
    assert line.checks.check("r1", BOARD) is line.checks.check("r1", BOARD)
    (job,) = line.jobs
    assert (job.run, job.bay, job.generation, job.slots, job.lights) == ("r1", 2, 7, {(0, 1): 4}, ("left",))
    for n in range(MOST_KEPT + 1):
        line.checks.check("r1", BOARD.model_copy(update={"revision": str(n)}))
    line.checks.check("r1", BOARD)
    assert len(line.jobs) == MOST_KEPT + 3


def test_a_correction_is_the_proposal_with_a_revision() -> None:
    proposal = BOARD.model_copy(update={"state": "draft", "revision": "A corrected"})
    line = Line(proposal)
    assert line.checks.correct("r1", BOARD, None) == proposal
    assert line.checks.correct("r1", BOARD, "B").revision == "B"
    with pytest.raises(StateError, match="proposes no correction"):
        Line(None).checks.correct("r1", BOARD, None)
