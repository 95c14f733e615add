"""Finished runs without a station: the real record, with stand-ins for what a test does not need."""

from __future__ import annotations

from dataclasses import fields
from types import SimpleNamespace
from typing import Any

from vaoi_station.model import Stitch
from vaoi_station.runs.archive.finished_runs import FinishedRun


class HeldRun(FinishedRun):
    """A finished run whose fields may be set. Without a document, `stitch` is its complete result."""

    @property
    def result(self) -> Stitch:
        assert self.stitch is not None
        return self.stitch

    def __setattr__(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)
        for derived in self.__dict__.keys() - {field.name for field in fields(self)}:
            del self.__dict__[derived]


def held_run(**known: Any) -> Any:
    """Return the finished run r1; fields that are not given are empty."""
    empty: dict[str, Any] = {
        "detail": SimpleNamespace(id="r1", frames=()), "finish_number": 1, "board_type": None, "cameras": (),
        "stitch": None, "document": None, "timeline": None, "head": None, "before": None, "identity": None,
    }  # fmt: skip
    return HeldRun(**(empty | known))
