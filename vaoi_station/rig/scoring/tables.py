"""Format the report of a rig run as text."""

from __future__ import annotations

from collections.abc import Iterator

from vaoi_station.rig.scoring.rig_report import BoardScore, RigReport

_HEAD = (
    "board",
    "verdict",
    "ok",
    "incomplete",
    "missing",
    "proven",
    "pulse µs",
    "sent ms",
    "px rms",
    "px max",
    "open",
    "ready ms",
)
_FORM = "{:>5s}  {:<9s}{:>6s}{:>12s}{:>9s}{:>8s}{:>10s}{:>9s}{:>8s}{:>8s}{:>6s}{:>10s}"
MOST = 40
"""Largest number of lines about incomplete and missing frames."""


def as_text(report: RigReport) -> str:
    """Format the report of a rig run as text tables."""
    return "\n".join(_lines(report))


def _lines(report: RigReport) -> Iterator[str]:
    size = f"{report.cameras} cameras, {report.width_px} × {report.height_px} at {report.frames_per_s:.2f} frames/s"
    yield f"scenario {report.scenario!r}: {size}; faults: {', '.join(report.faults) or 'none'}"
    yield _FORM.format(*_HEAD)
    for board in report.boards:
        yield _FORM.format(*_row(board))
    yield from _affected(report)
    yield from _reasons(report)
    for recovery in report.recoveries:
        after = "never" if recovery.ready_after_s is None else f"{recovery.ready_after_s:.1f} s later"
        yield f"{recovery.fault}: over at {recovery.back_s:.1f} s, the station was ready {after}"
    yield (
        f"positions of runs that are ok: {report.rms_px:.4f} px rms, {report.max_px:.4f} px at most; "
        f"boards missed: {report.boards_missed}"
    )
    if report.load is not None:
        load = report.load
        yield (
            f"cores over {load.over_s:.0f} s: station {load.station:.2f}, acquisition {load.acquisition:.2f} "
            f"({load.acquisition_ms_per_frame:.2f} ms per frame), workers {load.workers:.2f}; "
            f"senders {load.cameras:.2f}, chip {load.chip:.2f}, rig {load.rig:.2f}; "
            f"load of the machine {report.machine_load:.1f}"
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


def _reasons(report: RigReport) -> Iterator[str]:
    """Yield the reasons of every run, except those that only list frames: `_affected` yields the frames."""
    for board in report.boards:
        text = [reason for reason in board.reasons if not reason.startswith("Frames (camera, row)")]
        if text:
            yield f"  board {board.board}, {board.rows} of {board.rows_due} rows: {' '.join(text)}"


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
