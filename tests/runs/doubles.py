"""Doubles of the acquisition process, the ring and the workers that only record what they receive."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from vaoi_station.acquisition.process import messages
from vaoi_station.runs.workers.jobs import OpenRun


class Acquisition:
    """Collects commands."""

    def __init__(self) -> None:
        self.commands: list[messages.Command] = []

    def send(self, command: messages.Command) -> None:
        self.commands.append(command)

    def forget(self) -> None:
        """Nothing waits here: commands are collected at once."""

    def taken(self) -> list[str]:
        """Return the kinds of the commands since the last call."""
        kinds = [type(command).__name__ for command in self.commands]
        self.commands.clear()
        return kinds


class CountingRing:
    """Counts generations."""

    def __init__(self) -> None:
        self.generation = 0

    def renew(self, bay: int) -> int:
        self.generation += 1
        return self.generation


class Workers:
    """Collects what is submitted."""

    def __init__(self) -> None:
        self.jobs: list[Any] = []
        self.open: list[str] = []

    def busy(self) -> bool:
        return False

    def submit(self, job: Any, done: Any) -> None:
        self.jobs.append(job)

    def open_run(self, opening: OpenRun) -> None:
        self.open.append(opening.context.run)

    def close_run(self, run: str) -> None:
        self.open.remove(run)

    def hastened(self, kind: object, run: str) -> nullcontext[None]:
        return nullcontext()
