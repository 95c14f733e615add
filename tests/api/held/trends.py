"""The trends of a held station: figures that a test states, in a database of their own."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta

from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.trends.trends import (
    TrendComparison,
    TrendMark,
    Trends,
    bin_width_s,
    compare,
    groups_of_boards,
    series_of_groups,
    single_boards,
)
from vaoi_station.store.figures import BoardRow, Span


class HeldTrends:
    """Boards of two days: since the last calibration one seam is twice as wide."""

    def __init__(self) -> None:
        self.rows: list[BoardRow] = []
        self.found: list[TrendMark] = []

    def fill(self, boards: int, every: timedelta = timedelta(minutes=12)) -> None:
        """Add boards, the last of them now; the second half differs from the first."""
        now = datetime.now(UTC)
        for n in range(boards):
            time, late, wave = utc(now - every * (boards - 1 - n)), n >= boards // 2, (n * 7) % 11 / 11 - 0.5
            figures = {
                "residual_px": 0.06 + 0.01 * wave,
                "seam_px:0-1": (0.2 if late else 0.1) + 0.02 * wave,
                "seam_px:1-2": 0.08 + 0.02 * wave,
                "sigma_px": 0.05 + 0.004 * wave,
                "belt_mm_s": 100 + 0.4 * wave,
                "slip_percent": 0.4 * wave,
                "brightness_percent:cam0/left": (86 if n > boards - 9 else 99) + wave,
                "brightness_percent:cam1/left": 100 + wave,
                "drift_px:cam0": 0.01 + 0.01 * abs(wave),
                "drift_px:cam1": 0.02 + 0.01 * abs(wave),
                "ready_ms": 80 + 20 * wave,
                "lost_frames": float(n % 40 == 3),
                "unseen_parts": 0.0,
            }
            self.rows.append(BoardRow(f"r{n + 1:06d}", time, "demo-board", figures))
        middle = self.rows[boards // 2]
        self.found.append(
            TrendMark(time=middle.started, run=middle.run, kind="calibration", before="c0ffee00", after="ca11b4a7")
        )

    def trends(self, span: Span, wanted: Sequence[str], points: int) -> Trends:
        rows, marks = self._of(span), tuple(m for m in self.found if span.since <= m.time < span.until)
        common = {"since": span.since, "until": span.until, "board_type": span.board_type, "complete": True}
        if len(rows) <= points:
            return Trends(
                boards=len(rows), times=tuple(r.started for r in rows), runs=tuple(r.run for r in rows),
                counts=(1,) * len(rows), series=tuple(single_boards(rows, wanted)[2]), marks=marks, **common,
            )  # fmt: skip
        width_s = bin_width_s(span, points)
        groups = groups_of_boards(rows, width_s)
        return Trends(
            boards=len(rows), bin_s=width_s, times=tuple(g.time for g in groups),
            counts=tuple(g.boards for g in groups),
            series=tuple(series_of_groups(groups, wanted)), marks=marks, **common,
        )  # fmt: skip

    def figures(self, runs: Sequence[str]) -> dict[str, dict[str, float]]:
        return {row.run: dict(row.figures) for row in self.rows if row.run in runs}

    def compared(self, before: Span, now: Span) -> TrendComparison:
        earlier, later = self._of(before), self._of(now)
        return TrendComparison(
            before_since=before.since, before_until=before.until, since=now.since, until=now.until,
            board_type=now.board_type, before_boards=len(earlier), boards=len(later), changes=compare(earlier, later),
            marks=tuple(m for m in self.found if before.since <= m.time < now.until),
        )  # fmt: skip

    def _of(self, span: Span) -> list[BoardRow]:
        return [
            r for r in self.rows if span.since <= r.started < span.until and span.board_type in (None, r.board_type)
        ]
