"""Board types laid over finished runs: a worker checks them, one at a time, and the last replies are kept."""

from __future__ import annotations

import threading
from collections import OrderedDict

from vaoi_station.errors import StateError
from vaoi_station.model import BoardType
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.merging.merged_pictures import Lease, Render
from vaoi_station.runs.workers.picture_jobs import BoardCheckJob, CheckedBoard

MOST_KEPT = 4
"""Number of replies that are kept: picture and correction are asked for after the report."""


class BoardChecks:
    """Checks board types against runs. Methods may be called from any thread."""

    def __init__(self, archive: Archive, lease: Lease, render: Render) -> None:
        self._archive, self._lease, self._render = archive, lease, render
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, str], CheckedBoard] = OrderedDict()

    def own_type(self, run: str) -> str:
        """Return the name of the board type with which a run was filmed."""
        return self._archive.get(run).board_type.name

    def check(self, run: str, board_type: BoardType) -> CheckedBoard:
        """Lay a board type over a run. Other callers wait meanwhile, so that one worker is busy with it at most.

        Raises:
            GoneError: the frames of the run are no longer in memory.
            InputError: the board type cannot be checked.
            NotFoundError: the run is unknown, or ended without a result.
        """
        key = run, board_type.model_dump_json()
        with self._lock:
            if key not in self._kept:
                self._kept[key] = self._checked(self._archive.get(run), board_type)
            self._kept.move_to_end(key)
            while len(self._kept) > MOST_KEPT:
                self._kept.popitem(last=False)
            return self._kept[key]

    def correct(self, run: str, board_type: BoardType, revision: str | None) -> BoardType:
        """Return the corrected board type that a check proposes, as a draft.

        Raises:
            StateError: the check proposes nothing.
            VaoiError: as `check`.
        """
        report = self.check(run, board_type).report
        if report.proposal is None:
            said = "; ".join(warning.message for warning in report.warnings)
            raise StateError(
                f"The check of board type {board_type.name!r} against run {run} proposes no correction.",
                action=said or "Its components are where the pictures show them.",
                code="nothing-to-correct",
            )
        return report.proposal if revision is None else report.proposal.model_copy(update={"revision": revision})

    def _checked(self, finished: FinishedRun, board_type: BoardType) -> CheckedBoard:
        run, head = finished.detail.id, finished.head
        lights = (head.lights or ()) if head is not None else ()
        with self._lease(run, "check of a board type") as bay:
            job = BoardCheckJob(
                run, bay.number, bay.generation, finished.slots, finished.lean, finished.cameras, lights,
                finished.board_type, board_type,
            )  # fmt: skip
            checked: CheckedBoard = self._render(job, "check of a board type")
        return checked
