"""Format the report as text: one line per finding, and the action, if any, on the next line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from vaoi_station.doctor.finding import Finding, Level, Report

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
