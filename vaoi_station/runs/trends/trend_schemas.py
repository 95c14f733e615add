"""Schemas of the documents about trends. The documents are immutable and become JSON as they are."""

from __future__ import annotations

from typing import Literal

from vaoi_station.runs.states.schemas import Schema

MarkKind = Literal["calibration", "configuration", "board-type", "light", "reference", "software"]


class TrendSeries(Schema):
    """One figure over time."""

    figure: str
    """Name of the figure, with its unit."""
    part: str = ""
    """What the figure is of: a pair of cameras, a camera, a camera and a light ("left/ring"); empty: the board."""
    lower: float | None = None
    """Limit below which a value is conspicuous; None without such a limit."""
    upper: float | None = None
    """Limit above which a value is conspicuous."""
    at: tuple[int, ...]
    """Index in `times` of every value: some boards do not have the figure."""
    values: tuple[float, ...]
    """Value of the board, or mean of the boards."""
    least: tuple[float, ...] | None = None
    """Least value of the boards; None if each time is that of one board."""
    largest: tuple[float, ...] | None = None
    runs: tuple[str, ...] | None = None
    """Run with the largest magnitude, of brightness the darkest; None if each time is that of one board."""


class TrendMark(Schema):
    """From this board on, something that figures depend on was another."""

    time: str
    run: str
    kind: MarkKind
    board_type: str | None = None
    """The board type that it concerns; None: all."""
    before: str
    """Digest, version, run of the reference, or lights with their exposures; empty: none."""
    after: str


class Trends(Schema):
    """Figures of the boards of a span."""

    since: str
    until: str
    board_type: str | None = None
    boards: int
    """Number of boards in the span."""
    bin_s: float | None = None
    """Each value is of the boards of this many seconds from its time on; None: of one board."""
    times: tuple[str, ...]
    """Times at which boards came, or begin of each bin; bins without boards are left out."""
    runs: tuple[str, ...] | None = None
    """Run of each of the times; None with bins."""
    counts: tuple[int, ...]
    """Number of boards of each of the times."""
    series: tuple[TrendSeries, ...]
    marks: tuple[TrendMark, ...]
    complete: bool
    """Whether all series, marks and times of the span are there; False: the newest, or the first series by name."""


class SpanFigure(Schema):
    """One figure of the boards of a span."""

    boards: int
    """Number of boards with this figure."""
    middle: float
    """Median; of counts (`lost_frames`, `unseen_parts`), which are 0 on most boards, the mean."""
    spread: float
    """Standard deviation from board to board, from the median absolute deviation; of counts, three standard deviations
    of the mean."""


class TrendChange(Schema):
    """How one figure differs between two spans."""

    figure: str
    part: str
    before: SpanFigure
    now: SpanFigure
    change: float
    """`middle` of now minus that of before."""
    spreads: float
    """Magnitude of the change divided by the larger of both spreads; the list is sorted by it."""
    changed: bool
    """Whether the change is larger than the spread, and larger than chance explains."""
    worse: bool | None = None
    """Whether the figure has become worse; None if neither direction is better."""


class TrendComparison(Schema):
    """Which figures changed between two spans by more than their spread, the largest change first."""

    before_since: str
    before_until: str
    since: str
    until: str
    board_type: str | None = None
    before_boards: int
    boards: int
    changes: tuple[TrendChange, ...]
    """All figures that both spans have, also those that did not change."""
    marks: tuple[TrendMark, ...]
    """What changed between the begin of the earlier span and the end of the later one."""
