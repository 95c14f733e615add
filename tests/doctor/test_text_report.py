"""The report as text."""

from __future__ import annotations

from dataclasses import replace

from vaoi_station.doctor.finding import Finding, Report, fault, not_applicable, ok, warning
from vaoi_station.doctor.text_report import as_text


def report(station: str, *findings: Finding) -> Report:
    """Return a report with these findings."""
    return Report(station, "station.toml", "2026-01-01T00:00:00+00:00", "host", "1.0", None, findings)


def test_lines_actions_and_summary() -> None:
    findings = (
        replace(ok("fine"), check="disk"),
        replace(fault("is absent", "Check it.", code="x", subject="left"), check="cameras"),
        replace(warning("slow", "Hurry.", code="y"), check="disk"),
        replace(not_applicable("none"), check="usb"),
    )
    assert as_text(report("s", *findings)).splitlines() == [
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
    assert as_text(report("", ok("fine"), ok("fine"))).endswith("\n0 faults, 0 warnings, 2 ok, 0 not applicable\n")
