"""Findings, levels and the report."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.doctor.finding import Finding, Level, Report, as_text, fault, not_applicable, ok, warning


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


def named(station: str, *findings: Finding) -> Report:
    """Return a report with these findings."""
    return Report(station, "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, findings)


def test_lines_actions_and_summary() -> None:
    findings = (
        replace(ok("fine"), check="disk"),
        replace(fault("x", "is absent", "Check it.", "left"), check="cameras"),
        replace(warning("y", "slow", "Hurry."), check="disk"),
        replace(not_applicable("none"), check="usb"),
    )
    assert as_text(named("s", *findings)).splitlines() == [
        "ok       disk     fine",
        "FAULT    cameras  left: is absent",
        "                  → Check it.",
        "WARNING  disk     slow",
        "                  → Hurry.",
        "-        usb      none",
        "",
        "station 's': 1 fault, 1 warning, 1 ok, 1 not applicable",
    ]
