"""Something of an archive that cannot be used."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from vaoi_station.errors import VaoiError


class ArchiveFault(NamedTuple):
    """Something of an archive that cannot be used: the rest can."""

    what: str
    """The run, manifest or blob, and what is wrong with it."""
    action: str

    def __str__(self) -> str:
        return f"{self.what} {self.action}".strip()

    @classmethod
    def of(cls, error: VaoiError) -> ArchiveFault:
        """Return the fault that an error states."""
        return cls(error.message, error.action)


OnFault = Callable[[ArchiveFault], None]


def ignore_fault(_: ArchiveFault) -> None:
    """Take no notice of a fault."""
