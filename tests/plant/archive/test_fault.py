"""Faults of an archive are two sentences."""

from __future__ import annotations

from vaoi_station.errors import InputError
from vaoi_station.plant.archive.fault import ArchiveFault


def test_a_fault_says_what_is_wrong_and_what_to_do() -> None:
    assert (
        str(ArchiveFault.of(InputError("A blob is missing.", action="Restore it."))) == "A blob is missing. Restore it."
    )
    assert str(ArchiveFault("A blob is missing.", "")) == "A blob is missing."
