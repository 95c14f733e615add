"""Routes under `trends`: figures over boards and days, and the comparison of two spans."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Response

from vaoi_station.api.http_caching import json_of
from vaoi_station.api.limits import QueuedSeats, ThreadLimit
from vaoi_station.api.parameters import Moment, rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.runs.states.run_ids import in_utc, utc
from vaoi_station.runs.trends.trends import TrendComparison, Trends
from vaoi_station.store.figures import Span

LONGEST = timedelta(days=3660)
"""Longest span of one request: as long as figures per hour are kept."""
DAY = timedelta(days=1)
ANSWERS, ANSWERS_OF_CALLER = 4, 2
"""Largest number of answers, in all and of one caller, that are made or not yet read; one may have some megabytes."""
ANSWERS_WAITING = 16
ANSWER_WAIT_S = 20.0
FigureName = Literal[
    "residual_px", "seam_px", "sigma_px", "belt_mm_s", "slip_percent", "brightness_percent", "drift_px", "ready_ms",
    "lost_frames", "unseen_parts",
]  # fmt: skip
TypeName = Annotated[str | None, Query(description="Name of the board type.", max_length=200)]


def router(services: Services) -> APIRouter:
    """Create the routes for trends."""
    routes = rest_router(prefix="/trends", tags=["runs"])
    history = services.coordinator.kept
    # Reading takes the interpreter's lock for up to a second: one caller at a time, in none of the threads of commands.
    reading = ThreadLimit(1)
    seats = QueuedSeats("answers with figures", ANSWERS, ANSWERS_OF_CALLER, ANSWERS_WAITING, ANSWER_WAIT_S)

    async def answer(call: Callable[[], Trends | TrendComparison]) -> Response:
        # The document becomes text in the thread: it may have half a million values, too many for the event loop.
        return Response(await reading.ask(lambda: json_of(call())), media_type="application/json")

    @routes.get("", response_model=Trends, dependencies=[Depends(seats.hold)])
    async def get_trends(
        *,
        since: Moment = None,
        until: Moment = None,
        board_type: TypeName = None,
        figure: Annotated[
            list[FigureName] | None, Query(description="Name of a figure; may be repeated. None: all.", max_length=10)
        ] = None,
        points: Annotated[int, Query(description="Largest number of times in the reply.", ge=10, le=2000)] = 600,
    ) -> Response:
        """Return the figures of the boards of a span: the last day, unless it is stated.

        There is one value per board, or per bin of time with mean, least and largest value if there are more boards
        than `points`. Figures of single boards are kept for 200,000 boards (fewer with a small `database_gb`), figures
        per hour for ten years; both longer than the runs. At most 200 series and 200 marks are returned (`complete`).
        """
        span = _span("since", since, "until", until, datetime.now(UTC), board_type)
        return await answer(lambda: history.trends.trends(span, figure or (), points))

    @routes.get("/comparison", response_model=TrendComparison, dependencies=[Depends(seats.hold)])
    async def compare_trends(
        *,
        since: Moment = None,
        until: Moment = None,
        before_since: Moment = None,
        before_until: Moment = None,
        board_type: TypeName = None,
    ) -> Response:
        """Compare the figures of two spans, and rank them by the change in spreads from board to board.

        Without times, the last day is compared with the day before it. Only boards whose figures are kept one by one
        are compared; of more than 4000 boards of a span, every n-th is read.
        """
        now = _span("since", since, "until", until, datetime.now(UTC), board_type)
        end = datetime.fromisoformat(now.since)
        before = _span("before_since", before_since, "before_until", before_until, end, board_type)
        return await answer(lambda: history.trends.compared(before, now))

    return routes


def _span(
    first: str, since: datetime | None, last: str, until: datetime | None, end: datetime, board_type: str | None
) -> Span:
    """Return a span that two parameters state; without them, the day before `end`."""
    until = in_utc(until or end)
    since = in_utc(since or until - DAY)
    if not timedelta(0) < until - since <= LONGEST:
        raise InputError(
            f"{first} is {since.isoformat()} and {last} is {until.isoformat()}: {first} must be earlier, by "
            f"{LONGEST.days} days at most.",
            action="State an earlier begin, or a shorter span.",
        )
    return Span(utc(since), utc(until), board_type)
