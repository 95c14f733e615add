"""The report of a rig run, what in it went wrong, and its text for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vaoi_station.demo.report import Deviation
from vaoi_station.model import Strict
from vaoi_station.rig.faults import Fault, followers

LIMIT_PX = 0.10
"""Largest accepted rms position error of components, over all boards with the verdict ok. Runs with another verdict do
not count, because their results state a larger uncertainty.
"""
LATE_MS = 300.0
"""Delay from a pulse to the first packet of a frame above which the frame may arrive too late for the station."""
READY_LIMIT_S = 12.0


class AffectedFrame(Strict):
    """A frame that the station reports as incomplete or missing, with the fault that the rig injected."""

    camera: int
    row: int
    verdict: str
    cause: str
    """Cause that the station reports; empty: none."""
    done: str


class BoardScore(Strict):
    """The score of one board: its run compared with the truth, the rendered frames and the injected faults."""

    board: int
    run: str | None
    """Id of the run by which the station recorded this board; None if there is no such run."""
    status: str | None
    armed_id: str | None
    """Board id with which the station was armed for this board; None if it was not armed for it."""
    board_id: str | None
    reasons: tuple[str, ...]
    rows: int
    rows_due: int
    """Number of pulses that the board needs to be filmed completely."""
    ok: int
    incomplete: int
    missing: int
    proven: int | None
    """Number of complete frames whose pixels all equal the frame rendered for that camera and row; None: unchecked."""
    wrong: tuple[str, ...]
    mislit: tuple[str, ...] = ()
    """Descriptions of frames whose light or exposure the station states otherwise than the chip fired them."""
    affected: tuple[AffectedFrame, ...]
    unfilmed: int
    pulse_off_us: float
    """Largest difference between a pulse and the time for which its frames were rendered."""
    sent_late_ms: float | None
    """Longest time from a pulse to the first packet of a frame; None: at least one frame never left its camera."""
    notes: tuple[str, ...]
    deviation: Deviation
    ready_after_last_frame_ms: float | None
    links_open: int | None
    """Number of stitching tasks not done when the last frame arrived. Tasks of the last row can only begin then."""

    held_s: float | None = 0.0
    """Time, s, for which the conveyor held the board back until the output "line ready" was on; None: it did not come
    on, and the board passed nevertheless."""


class Recovery(Strict):
    """Recovery of the station from one fault: when the device worked again, and when the station was ready again."""

    fault: str
    back_s: float
    """Time since the start of the rig at which the device worked again."""
    ready_after_s: float | None
    """Time from the recovery of the device until the station was ready with all cameras; None: it was not."""


class RigReport(Strict):
    """The document that `vaoi rig run --json` writes."""

    format: str = "vaoi-rig"
    version: int = 5
    ok: bool
    scenario: str
    cameras: int
    width_px: int
    height_px: int
    frames_per_s: float
    faults: tuple[str, ...]
    boards: tuple[BoardScore, ...]
    runs: int
    boards_missed: int
    stray_pulses: int
    rms_px: float
    max_px: float
    recoveries: tuple[Recovery, ...]
    took_s: float
    failings: tuple[str, ...]


def failings(report: RigReport, faults: Sequence[Fault], boards: int) -> Iterator[str]:
    """Yield one sentence for each way in which a rig run of `boards` boards went wrong."""
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
    for frame in board.affected:
        if not frame.done:
            yield f"{where}: camera {frame.camera}, row {frame.row} is not whole, and no fault was injected"
        if not frame.cause:
            yield f"{where}: camera {frame.camera}, row {frame.row} is not whole, and the station reports no cause"
    yield from _verdict_failings(board, board.board in hurt)


def _verdict_failings(board: BoardScore, hurt: bool) -> Iterator[str]:
    where = f"board {board.board}"
    if board.rows < board.rows_due and not board.reasons:
        yield f"{where}: only {board.rows} of {board.rows_due} rows were fired, and the station reports no reason"
    # Of a board that has lost rows by a fault, only a reason is required, not the verdict ok.
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


_HEAD = (
    "board", "verdict", "ok", "incomplete", "missing", "proven",
    "pulse µs", "sent ms", "px rms", "px max", "open", "ready ms",
)  # fmt: skip
_FORM = "{:>5s}  {:<9s}{:>6s}{:>12s}{:>9s}{:>8s}{:>10s}{:>9s}{:>8s}{:>8s}{:>6s}{:>10s}"
MOST = 40


def text_lines(report: RigReport) -> Iterator[str]:
    """Yield the report of a rig run as lines of text."""
    size = f"{report.cameras} cameras, {report.width_px} × {report.height_px} at {report.frames_per_s:.2f} frames/s"
    yield f"scenario {report.scenario!r}: {size}; faults: {', '.join(report.faults) or 'none'}"
    yield _FORM.format(*_HEAD)
    for board in report.boards:
        yield _FORM.format(*_row(board))
    yield from _affected(report)
    for board in report.boards:
        # The frames are listed above.
        if reasons := [reason for reason in board.reasons if not reason.startswith("Frames (camera, row)")]:
            yield f"  board {board.board}, {board.rows} of {board.rows_due} rows: {' '.join(reasons)}"
    for recovery in report.recoveries:
        after = "never" if recovery.ready_after_s is None else f"{recovery.ready_after_s:.1f} s later"
        yield f"{recovery.fault}: over at {recovery.back_s:.1f} s, the station was ready {after}"
    yield (
        f"positions of runs that are ok: {report.rms_px:.4f} px rms, {report.max_px:.4f} px at most; "
        f"boards missed: {report.boards_missed}"
    )
    yield f"took {report.took_s:.0f} s: {'all checks passed' if report.ok else 'checks FAILED'}"
    for text in report.failings:
        yield f"  - {text}"


def _row(board: BoardScore) -> tuple[str, ...]:
    deviation, placed = board.deviation, board.deviation.views > 0
    return (
        str(board.board),
        board.status or "no run",
        f"{board.ok}",
        f"{board.incomplete}",
        f"{board.missing}",
        "?" if board.proven is None else f"{board.proven}",
        f"{board.pulse_off_us:.2f}",
        "?" if board.sent_late_ms is None else f"{board.sent_late_ms:.0f}",
        f"{deviation.rms_px:.3f}" if placed else "–",
        f"{deviation.max_px:.3f}" if placed else "–",
        "–" if board.links_open is None else f"{board.links_open}",
        "–" if board.ready_after_last_frame_ms is None else f"{board.ready_after_last_frame_ms:.0f}",
    )


def _affected(report: RigReport) -> Iterator[str]:
    groups: dict[tuple[int, int, str, str, str], list[int]] = {}
    for board in report.boards:
        for named in board.affected:
            key = (board.board, named.camera, named.verdict, named.cause, named.done)
            groups.setdefault(key, []).append(named.row)
    for (number, camera, verdict, cause, done), rows in list(groups.items())[:MOST]:
        text = done or "NO fault was injected"
        yield f"  board {number}, camera {camera}, row {_ranges(rows)}: {verdict}, {cause!r} ({text})"
    if len(groups) > MOST:
        yield f"  … and {len(groups) - MOST} more"


def _ranges(rows: list[int]) -> str:
    """Return row numbers as text with ranges: [1, 2, 3, 7] gives "1–3, 7"."""
    spans: list[list[int]] = []
    for row in sorted(rows):
        if spans and row == spans[-1][1] + 1:
            spans[-1][1] = row
        else:
            spans.append([row, row])
    return ", ".join(f"{first}" if first == last else f"{first}–{last}" for first, last in spans)
