"""Whether a rig run is as it must be, and if not, why: pure logic over the report."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vaoi_station.rig.line.faults import Fault
from vaoi_station.rig.scoring.rig_report import LATE_MS, LIMIT_PX, READY_LIMIT_S, BoardScore, RigReport

_HARMLESS = {"noise", "bounce"}
"""Nothing may be lost by these."""


def failings(report: RigReport, faults: Sequence[Fault], boards: int) -> tuple[str, ...]:
    """One sentence each; empty: all is as it must be."""
    return tuple(_failings(report, faults, boards))


def _failings(report: RigReport, faults: Sequence[Fault], boards: int) -> Iterator[str]:
    if len(report.boards) < boards:
        yield f"only {len(report.boards)} of {boards} boards passed"
    hurt = {f.board for f in faults if f.kind in ("stuck", "reset") or f.who == "acquisition"}
    for board in report.boards:
        yield from _of_board(board, hurt)
    if report.boards_missed and not hurt:
        yield f"the station missed {report.boards_missed} board(s)"
    if report.stray_pulses:
        yield f"{report.stray_pulses} pulse(s) were fired while no board passed"
    if report.rms_px > LIMIT_PX:
        yield f"component positions are off by {report.rms_px} px rms, the limit is {LIMIT_PX}"
    for recovery in report.recoveries:
        if recovery.ready_after_s is None:
            yield f"after {recovery.fault} the station did not become ready again"
        elif recovery.ready_after_s > READY_LIMIT_S:
            yield f"after {recovery.fault} it took {recovery.ready_after_s} s to be ready, the limit is {READY_LIMIT_S}"


def _of_board(board: BoardScore, hurt: set[int]) -> Iterator[str]:
    where = f"board {board.board}"
    if board.run is None:
        yield f"{where} was not filmed"
        return
    for words in (*board.wrong, *board.notes):
        yield f"{where}: {words}"
    if board.proven is None:
        yield f"{where}: nobody could look at its pixels"
    elif board.proven != board.ok:
        yield f"{where}: {board.ok - board.proven} frame(s) that are told to be whole are not in the ring"
    if board.affected and (board.sent_late_ms is None or board.sent_late_ms > LATE_MS):
        late = "for ever" if board.sent_late_ms is None else f"{board.sent_late_ms:.0f} ms"
        yield f"{where}: the rig itself kept frames back {late}: this machine is too busy for a verdict"
    for cell in board.innocent:
        yield f"{where}: camera {cell[0]}, row {cell[1]} is not whole, and nothing was done to it"
    for cell in board.unnamed:
        yield f"{where}: camera {cell[0]}, row {cell[1]} is not whole, and no cause is told"
    yield from _of_its_words(board, board.board in hurt)


def _of_its_words(board: BoardScore, hurt: bool) -> Iterator[str]:
    """Verdict and reasons; of a board that a fault has cut or stopped only that there is a reason."""
    where = f"board {board.board}"
    if board.rows < board.rows_due and not board.reasons:
        yield f"{where}: only {board.rows} of {board.rows_due} rows were fired, and the station does not tell why"
    if hurt:
        return
    if board.rows < board.rows_due:
        yield f"{where}: only {board.rows} of {board.rows_due} rows were fired"
    if board.unfilmed:
        yield f"{where}: nothing is told of {board.unfilmed} frame(s) that were fired"
    if board.reasons and not board.affected:
        yield f"{where} is {board.status}, but says: {'; '.join(board.reasons)}"
    elif board.status not in (("ok", "degraded") if board.affected else ("ok",)):
        yield f"{where} is {board.status}: {'; '.join(board.reasons)}"
