"""Repeated messages are limited, and the number of those that were dropped is logged."""

from __future__ import annotations

import logging

from vaoi_station.runs.host import log_repeats
from vaoi_station.runs.host.log_repeats import SAME_TEMPLATE, SAME_TEXT, WINDOW_S, RepeatLimit


class Clock:
    now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def logged(limit: RepeatLimit, template: str, *values: object, level: int = logging.ERROR) -> str | None:
    record = logging.LogRecord("x", level, __file__, 1, template, values, None)
    return record.getMessage() if limit.filter(record) else None


def test_the_same_text_is_logged_a_few_times_and_then_counted() -> None:
    clock = Clock()
    limit = RepeatLimit(clock)
    seen = [logged(limit, "too many open files") for _ in range(1000)]
    assert [text for text in seen if text] == ["too many open files"] * SAME_TEXT
    assert logged(limit, "another") == "another"
    clock.now_s = WINDOW_S + 1
    text = logged(limit, "too many open files")
    assert text is not None
    assert f"{1000 - SAME_TEXT} more" in text
    assert logged(limit, "too many open files") == "too many open files"


def test_warnings_that_differ_in_values_only_are_limited_too() -> None:
    limit = RepeatLimit(Clock())
    seen = [logged(limit, "caller %s does not read", n) for n in range(5000)]
    assert len([text for text in seen if text]) == SAME_TEMPLATE


def test_events_of_boards_are_not_limited() -> None:
    limit = RepeatLimit(Clock())
    assert all(logged(limit, "run %s", n, level=logging.INFO) for n in range(5000))


def test_memory_is_bounded() -> None:
    limit = RepeatLimit(Clock())
    for n in range(3 * log_repeats.MOST_KEYS):
        logged(limit, "run %s", n, level=logging.INFO)
    assert len(limit._texts) <= log_repeats.MOST_KEYS


def test_texts_that_never_come_again_do_not_pile_up() -> None:
    """Every board has texts of its own: the station would grow over its first thousand boards."""
    clock = Clock()
    limit = RepeatLimit(clock)
    for _ in range(SAME_TEXT + 3):
        logged(limit, "too many open files")
    for n in range(500):
        clock.now_s += 1.0
        logged(limit, "run %s", n, level=logging.INFO)
    assert len(limit._texts) <= WINDOW_S + 2
    text = logged(limit, "too many open files")
    assert text is not None
    assert "3 more" in text, "what was dropped is still stated"
