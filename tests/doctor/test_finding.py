"""Findings, levels and the report."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.doctor.finding import EXIT_CODES, Finding, Level, Report, as_text, fault, not_applicable, ok, warning


def report(*findings: Finding) -> Report:
    """Return a report with these findings."""
    return Report("s", "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, findings)


@pytest.mark.parametrize(
    ("findings", "worst", "code"),
    [
        ((), Level.OK, 0),
        ((not_applicable("none"),), Level.NOT_APPLICABLE, 0),
        ((ok("fine"), not_applicable("none")), Level.OK, 0),
        ((ok("fine"), warning("slow", "hurry", code="slow")), Level.WARNING, 1),
        ((fault("broken", "repair", code="broken"), warning("slow", "hurry", code="slow"), ok("fine")), Level.FAULT, 2),
    ],
)
def test_the_worst_level_decides_the_exit_code(findings: tuple[Finding, ...], worst: Level, code: int) -> None:
    made = report(*findings)
    assert (made.worst, made.exit_code) == (worst, code)
    assert made.document()["worst"] == ("ok" if code == 0 else str(worst))


@given(st.lists(st.sampled_from(Level)))
def test_counts_add_up_and_no_finding_is_below_the_exit_code(levels: list[Level]) -> None:
    made = report(*(Finding(level, "m") for level in levels))
    assert sum(made.counts.values()) == len(levels)
    assert made.exit_code == max((EXIT_CODES[level] for level in levels), default=0)
    assert sum(made.document()["counts"].values()) == len(levels)


def test_the_document_is_json_with_the_values_of_the_findings() -> None:
    made = report(fault("broken", "repair", code="broken", subject="left", figures={"limit_px": 1.5}))
    document = json.loads(json.dumps(made.document()))
    assert document["findings"] == [
        {"check": "", "subject": "left", "level": "fault", "code": "broken", "message": "broken", "action": "repair",
         "figures": {"limit_px": 1.5}},
    ]  # fmt: skip
    assert (document["format"], document["version"], document["running"]) == ("vaoi-doctor", 1, None)


def named(station: str, *findings: Finding) -> Report:
    """Return a report with these findings."""
    return Report(station, "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, findings)


def test_lines_actions_and_summary() -> None:
    findings = (
        replace(ok("fine"), check="disk"),
        replace(fault("is absent", "Check it.", code="x", subject="left"), check="cameras"),
        replace(warning("slow", "Hurry.", code="y"), check="disk"),
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


def test_a_station_without_a_name_and_plural_counts() -> None:
    assert as_text(named("", ok("fine"), ok("fine"))).endswith("\n0 faults, 0 warnings, 2 ok, 0 not applicable\n")
