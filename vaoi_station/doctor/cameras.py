"""Every camera: is it there, is it free, and can it be triggered? Of a running station, its own word."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from vaoi_station.doctor.finding import Figures, Finding, fault, not_applicable, ok, warning
from vaoi_station.doctor.patient import Patient


def cameras(patient: Patient) -> Iterator[Finding]:
    """One finding per camera."""
    if patient.running is not None:
        yield from of_running_station(patient)
    elif not patient.real_cameras:
        yield not_applicable(f"backend {patient.config.controller.backend!r}: there is nothing to reach")


def of_running_station(patient: Patient) -> Iterator[Finding]:
    """What the station says of its cameras."""
    assert patient.running is not None
    told = patient.running.snapshot.get("cameras", ())
    if not told:
        yield warning(
            "a process uses them that does not say how they are; they are left alone.",
            f"ps -fp {patient.running.pid}; end it, and run vaoi doctor again",
        )
    yield from (_of_camera(camera) for camera in told)


def _of_camera(told: dict[str, Any]) -> Finding:
    name, message = str(told.get("name")), str(told.get("message") or "")
    figures: Figures = {key: told.get(key) for key in ("delivered", "incomplete", "temperature_c")}
    if not told.get("connected"):
        action = "Check its power and cable; the station opens it by itself when it is back."
        return fault(f"is not connected: {message or 'no reason given'}", action, subject=name, figures=figures)
    if message:
        return warning(message, "See docs/acquisition.md.", subject=name, figures=figures)
    counted = f"{figures['delivered']} frames delivered, {figures['incomplete']} incomplete"
    return ok(f"connected, {counted}", subject=name, figures=figures)
