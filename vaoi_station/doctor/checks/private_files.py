"""Who may read a file with a secret."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from vaoi_station.doctor.finding import Finding, warning

_OTHERS = 0o007
"""Permissions of users who are neither owner nor group of a file."""


def readable_by_others(path: Path, what: str, subject: str) -> Iterator[Finding]:
    """Warn of a file with a secret that every user of the machine can read."""
    if path.stat().st_mode & _OTHERS:
        yield warning(
            f"{what} in {path} can be read by every user.",
            f"chmod o= {path}",
            subject=subject,
            code="secret-not-private",
            figures={"path": str(path)},
        )
