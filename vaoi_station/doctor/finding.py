"""What a check found, and the report of all of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

FORMAT, VERSION = "vaoi-doctor", 1
Figures = Mapping[str, float | int | str | bool | None]
"""What was measured, with units in the names; for programs."""


class Level(StrEnum):
    """How bad it is; the order is that of the exit code."""

    NOT_APPLICABLE = "not-applicable"
    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


EXIT_CODES = {Level.NOT_APPLICABLE: 0, Level.OK: 0, Level.WARNING: 1, Level.FAULT: 2}


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    level: Level
    message: str
    action: str = ""
    """What to do: one concrete step; empty where there is nothing to do."""
    subject: str = ""
    """Which camera, file or port, where a check looks at several."""
    figures: Figures = field(default_factory=dict)
    check: str = ""


def ok(message: str, *, subject: str = "", figures: Figures | None = None) -> Finding:
    """Nothing to do."""
    return Finding(Level.OK, message, subject=subject, figures=figures or {})


def warning(message: str, action: str, *, subject: str = "", figures: Figures | None = None) -> Finding:
    """It works, but not on a bad day."""
    return Finding(Level.WARNING, message, action, subject, figures or {})


def fault(message: str, action: str, *, subject: str = "", figures: Figures | None = None) -> Finding:
    """The station will not film like this."""
    return Finding(Level.FAULT, message, action, subject, figures or {})


def not_applicable(message: str) -> Finding:
    """There is nothing to look at."""
    return Finding(Level.NOT_APPLICABLE, message)


@dataclass(frozen=True)
class Report:
    """Everything that was found, in the order of the checks."""

    station: str
    """Name of the station; empty where its configuration could not be read."""
    config: str
    created: str
    """UTC, RFC 3339."""
    host: str
    version: str
    running: int | None
    """Process that owns the station's memory while it runs."""
    findings: tuple[Finding, ...]

    @property
    def worst(self) -> Level:
        """The level that counts."""
        return max((f.level for f in self.findings), key=lambda level: EXIT_CODES[level], default=Level.OK)

    @property
    def exit_code(self) -> int:
        """0: nothing to do, 1: warnings, 2: faults."""
        return EXIT_CODES[self.worst]

    @property
    def counts(self) -> dict[Level, int]:
        """Findings per level."""
        return {level: sum(f.level is level for f in self.findings) for level in Level}

    def document(self) -> dict[str, Any]:
        """The report as JSON data; described in docs/engineering/doctor.md."""
        return {
            "format": FORMAT,
            "version": VERSION,
            "created": self.created,
            "host": self.host,
            "vaoi_station": self.version,
            "station": self.station,
            "config": self.config,
            "running": self.running,
            "worst": "ok" if self.exit_code == 0 else str(self.worst),
            "counts": {str(level): count for level, count in self.counts.items()},
            "findings": [
                {
                    "check": f.check,
                    "subject": f.subject,
                    "level": str(f.level),
                    "message": f.message,
                    "action": f.action,
                    "figures": dict(f.figures),
                }
                for f in self.findings
            ],
        }
