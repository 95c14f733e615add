"""Decide whether a rig run went as expected, and describe each deviation in a sentence. No I/O."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vaoi_station.rig.line.faults import Fault, followers
from vaoi_station.rig.scoring.rig_report import LATE_MS, LIMIT_PX, READY_LIMIT_S, BoardScore, RigReport


def failings(report: RigReport, faults: Sequence[Fault], boards: int) -> tuple[str, ...]:
    """Return one sentence for each way in which a rig run of `boards` boards went wrong; empty if it went well."""
    return tuple(_failings(report, faults, boards))


def _failings(report: RigReport, faults: Sequence[Fault], boards: int) -> Iterator[str]:
    if len(report.boards) < boards:
        yield f"only {len(report.boards)} of {boards} boards passed"
    # After these faults a board has fewer rows, so its missing rows and its verdict are expected.
    hurt = {f.board for f in faults if f.kind in ("stuck", "reset", "follow") or f.who == "acquisition"}
    # With the first board whose stamps come later, its frames may be in wrong rows; the station must say so.
    shifted = {f.board for f in faults if f.kind == "stamps"}
    for board in report.boards:
        if board.board in shifted and board.status != "ok" and board.reasons:
            continue
        yield from _board_failings(board, hurt)
    yield from _account_failings(report, faults)
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


def _account_failings(report: RigReport, faults: Sequence[Fault]) -> Iterator[str]:
    """Yield errors in the account of boards: a board is neither a run nor missed, or a run has another board's id."""
    extra = followers(faults)
    if extra and report.runs + report.boards_missed != len(report.boards) + extra:
        yield (
            f"{len(report.boards) + extra} boards met the barrier, but the station has {report.runs} run(s) and "
            f"{report.boards_missed} missed board(s)"
        )
    for board in report.boards:
        if board.board_id is not None and board.board_id != board.armed_id:
            yield f"board {board.board}: its run has the board id {board.board_id!r}, armed was {board.armed_id!r}"
        elif board.board_id is None and board.run is not None and board.armed_id is not None and not board.reasons:
            yield f"board {board.board}: its run has no board id and no reason, armed was {board.armed_id!r}"


def _board_failings(board: BoardScore, hurt: set[int]) -> Iterator[str]:
    where = f"board {board.board}"
    if board.run is None:
        yield f"{where} has no run"
        return
    for words in (*board.wrong, *board.mislit, *board.notes):
        yield f"{where}: {words}"
    if board.proven is None:
        yield f"{where}: its pixels could not be checked"
    elif board.proven != board.ok:
        yield f"{where}: {board.ok - board.proven} frame(s) reported as whole are not in the ring"
    if board.affected and (board.sent_late_ms is None or board.sent_late_ms > LATE_MS):
        late = "without end" if board.sent_late_ms is None else f"by {board.sent_late_ms:.0f} ms"
        yield f"{where}: the rig itself delayed frames {late}: this machine is too busy for a verdict"
    for cell in board.innocent:
        yield f"{where}: camera {cell[0]}, row {cell[1]} is not whole, and no fault was injected"
    for cell in board.unnamed:
        yield f"{where}: camera {cell[0]}, row {cell[1]} is not whole, and the station reports no cause"
    yield from _result_failings(board, board.board in hurt)


def _result_failings(board: BoardScore, hurt: bool) -> Iterator[str]:
    """Yield each error in a board's verdict and reasons.

    If `hurt` is true, the board has lost rows by a fault. Then only a reason is required, not the verdict ok.
    """
    where = f"board {board.board}"
    if board.rows < board.rows_due and not board.reasons:
        yield f"{where}: only {board.rows} of {board.rows_due} rows were fired, and the station reports no reason"
    if hurt:
        return
    if board.rows < board.rows_due:
        yield f"{where}: only {board.rows} of {board.rows_due} rows were fired"
    if board.unfilmed:
        yield f"{where}: the station does not list {board.unfilmed} frame(s) that were fired"
    if board.reasons and not board.affected:
        yield f"{where} is {board.status}, but has reasons: {'; '.join(board.reasons)}"
    elif board.status not in (("ok", "degraded") if board.affected else ("ok",)):
        yield f"{where} is {board.status}: {'; '.join(board.reasons)}"
