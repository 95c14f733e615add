"""The findings of the checks, and the report that contains them, as a document and as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

FORMAT, VERSION = "vaoi-doctor", 1
Figure = float | int | str | bool | None
Figures = Mapping[str, Figure]
"""Values for programs: measured ones with units in the names, and files or names that the message states."""


class Level(StrEnum):
    """The severity of a finding: no check needed, no problem, a problem, or a problem that prevents filming."""

    NOT_APPLICABLE = "not-applicable"
    OK = "ok"
    WARNING = "warning"
    FAULT = "fault"


# "not applicable" counts as "ok": the report of a station without USB cameras must not end with a warning.
EXIT_CODES = {Level.NOT_APPLICABLE: 0, Level.OK: 0, Level.WARNING: 1, Level.FAULT: 2}


@dataclass(frozen=True)
class Finding:
    """The outcome of one check, which is one line of the report."""

    level: Level
    message: str
    action: str = ""
    subject: str = ""
    """The camera, file or port that the finding concerns, for checks that examine several; otherwise empty."""
    figures: Figures = field(default_factory=dict)
    check: str = ""
    code: str = ""
    """What is wrong, for programs and translations (docs/codes.md); empty without a problem."""


def ok(message: str, subject: str = "", /, **figures: Figure) -> Finding:
    """Make a finding without a problem."""
    return Finding(Level.OK, message, "", subject, figures)


def warning(code: str, message: str, action: str, subject: str = "", /, **figures: Figure) -> Finding:
    """Make a finding of a problem with which the station can still film."""
    return Finding(Level.WARNING, message, action, subject, figures, code=code)


def fault(code: str, message: str, action: str, subject: str = "", /, **figures: Figure) -> Finding:
    """Make a finding of a problem because of which the station cannot film."""
    return Finding(Level.FAULT, message, action, subject, figures, code=code)


def not_applicable(message: str) -> Finding:
    """Make the finding of a check that does not apply to this station."""
    return Finding(Level.NOT_APPLICABLE, message)


@dataclass(frozen=True)
class Report:
    """All findings, in the order of the checks."""

    station: str
    """Name of the station; empty if its configuration could not be read."""
    config: str
    created: str
    host: str
    version: str
    running: int | None
    """Id of the process that owns the station's ring; None if none does or its id is hidden."""
    findings: tuple[Finding, ...]

    @property
    def worst(self) -> Level:
        """The most severe level among all findings."""
        return max((f.level for f in self.findings), key=lambda level: EXIT_CODES[level], default=Level.OK)

    @property
    def exit_code(self) -> int:
        """The exit code of the command: 0 without problems, 1 with warnings, 2 with faults."""
        return EXIT_CODES[self.worst]

    @property
    def counts(self) -> dict[Level, int]:
        """The number of findings by level."""
        return {level: sum(f.level is level for f in self.findings) for level in Level}

    def document(self) -> dict[str, Any]:
        """Return the report as JSON data, as docs/how-to/doctor.md describes it."""
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
                    "code": f.code,
                    "message": f.message,
                    "action": f.action,
                    "figures": dict(f.figures),
                }
                for f in self.findings
            ],
        }


_SIGNS = {Level.OK: "ok", Level.WARNING: "WARNING", Level.FAULT: "FAULT", Level.NOT_APPLICABLE: "-"}


def as_text(report: Report) -> str:
    """Format the report of `vaoi doctor` as text, one line for each finding."""
    width = max(len(finding.check) for finding in report.findings)
    lines = [line for finding in report.findings for line in _lines(finding, width)]
    return "\n".join([*lines, "", _summary(report)]) + "\n"


def problems_as_text(file: Path, findings: Sequence[Finding]) -> str:
    """Format the warnings and faults of `vaoi check-config`, and their numbers; one sentence if there are none."""
    problems = [finding for finding in findings if finding.action]
    if not problems:
        return f"{file}: no problem found."
    levels = [finding.level for finding in problems]
    counts = f"{_counted(levels.count(Level.FAULT), 'fault')}, {_counted(levels.count(Level.WARNING), 'warning')}"
    width = max(len(finding.check) for finding in problems)
    return "\n".join([*(line for finding in problems for line in _lines(finding, width)), f"{file}: {counts}"])


def _lines(finding: Finding, width: int) -> list[str]:
    subject = f"{finding.subject}: " if finding.subject else ""
    lines = [f"{_SIGNS[finding.level]:<8} {finding.check:<{width}}  {subject}{finding.message}"]
    if finding.action:
        lines.append(f"{'':<8} {'':<{width}}  → {finding.action}")
    return lines


def _summary(report: Report) -> str:
    counts = report.counts
    parts = [_counted(counts[Level.FAULT], "fault"), _counted(counts[Level.WARNING], "warning")]
    parts += [f"{counts[Level.OK]} ok", f"{counts[Level.NOT_APPLICABLE]} not applicable"]
    return f"station {report.station!r}: {', '.join(parts)}" if report.station else ", ".join(parts)


def _counted(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"
