"""Findings, levels and the report."""

from __future__ import annotations

import pytest

from vaoi_station.doctor.finding import Finding, Level, Report, fault, not_applicable, ok, warning


def report(*findings: Finding) -> Report:
    """Return a report with these findings."""
    return Report("s", "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, findings)


@pytest.mark.parametrize(
    ("findings", "worst", "code"),
    [
        ((), Level.OK, 0),
        ((not_applicable("none"),), Level.NOT_APPLICABLE, 0),
        ((ok("fine"), not_applicable("none")), Level.OK, 0),
        ((ok("fine"), warning("slow", "slow", "hurry")), Level.WARNING, 1),
        ((fault("broken", "broken", "repair"), warning("slow", "slow", "hurry"), ok("fine")), Level.FAULT, 2),
    ],
)
def test_the_worst_level_decides_the_exit_code(findings: tuple[Finding, ...], worst: Level, code: int) -> None:
    made = report(*findings)
    assert (made.worst, made.exit_code) == (worst, code)
    assert made.document()["worst"] == ("ok" if code == 0 else str(worst))
