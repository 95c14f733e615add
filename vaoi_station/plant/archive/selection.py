"""Which runs of an archive are meant: by board type, time, station and verdict."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase

from vaoi_station.errors import InputError
from vaoi_station.model import Status
from vaoi_station.plant.archive.manifest import ArchivedRun


@dataclass(frozen=True)
class RunSelection:
    """Conditions that a run must fulfil together; None admits every run."""

    board_type: str | None = None
    """Name, or a pattern with * and ?."""
    since: str | None = None
    """Earliest begin of a run: UTC, a day or RFC 3339."""
    until: str | None = None
    """Begin before which a run must have begun: the same; a day counts as a whole."""
    station: str | None = None
    """Name, or a pattern with * and ?."""
    verdict: Status | None = None

    def __post_init__(self) -> None:
        if self.since is not None:
            moment(self.since, "since")
        if self.until is not None:
            moment(self.until, "until")

    def admits(self, run: ArchivedRun) -> bool:
        """Return whether a run is meant."""
        return (
            _fits(run.board_type, self.board_type)
            and _fits(run.station, self.station)
            and (self.verdict is None or run.verdict is self.verdict)
            and (self.since is None or moment(run.time, "time") >= moment(self.since, "since"))
            and (self.until is None or moment(run.time, "time") < _end(self.until))
        )

    def admits_folder(self, station: str, day: str) -> bool:
        """Return whether runs of a station and day (YYYY-MM-DD) can be meant."""
        first, last = moment(day, "day"), _end(day)
        return (
            _fits(station, self.station)
            and (self.since is None or last > moment(self.since, "since"))
            and (self.until is None or first < _end(self.until))
        )


def moment(text: str, name: str) -> datetime:
    """Return a time in UTC from a day (its begin) or an RFC 3339 text; InputError names the field `name`."""
    try:
        parsed = datetime.fromisoformat(text)
        in_utc = parsed.astimezone(UTC) if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    except (ValueError, OverflowError) as error:
        raise InputError.field(
            "selection", name, text, "a day (2026-03-01) or a time with its zone (2026-03-01T08:00:00Z)"
        ) from error
    if parsed.tzinfo is None and len(text) > len("2026-03-01"):
        raise InputError.field("selection", name, text, "a time with its zone, such as 2026-03-01T08:00:00Z")
    return in_utc


def _end(text: str) -> datetime:
    start = moment(text, "until")
    if len(text) > len("2026-03-01"):
        return start
    # The last day that a datetime can hold has no next one.
    return start.replace(hour=23, minute=59, second=59) if start.year == 9999 else start + timedelta(days=1)


def matches(name: str, pattern: str) -> bool:
    """Return whether a name is meant by itself or by a pattern with * and ?, which the name itself may contain."""
    # A bracket is one of a name, as in "line [2]"; fnmatch would take it as the beginning of a set of characters.
    return name == pattern or fnmatchcase(name, pattern.replace("[", "[[]"))


def _fits(name: str, pattern: str | None) -> bool:
    return pattern is None or matches(name, pattern)
