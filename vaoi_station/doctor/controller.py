"""The controller: its port, who holds it, its firmware and its clock. Of a running station, its own word."""

from __future__ import annotations

from collections.abc import Iterator

from vaoi_station.doctor.finding import Finding, not_applicable, ok, warning
from vaoi_station.doctor.patient import Patient


def controller(patient: Patient) -> Iterator[Finding]:
    """Port, firmware, clock."""
    if patient.running is not None:
        yield of_running_station(patient)
    elif patient.config.controller.backend != "serial":
        yield not_applicable(f"backend {patient.config.controller.backend!r}: there is no port")


def of_running_station(patient: Patient) -> Finding:
    """What the station says of its controller; what is wrong with it is among the station's own complaints."""
    assert patient.running is not None
    if not patient.running.snapshot:
        return warning(
            "a process uses it that does not say how it is; it is left alone.",
            f"ps -fp {patient.running.pid}; end it, and run vaoi doctor again",
        )
    return ok(str(patient.running.snapshot.get("controller") or "nothing is known of it yet"))
