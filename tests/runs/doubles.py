"""Doubles of the acquisition process, the ring and the workers that only record what they receive."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from vaoi_station.acquisition.process import messages
from vaoi_station.runs.workers.jobs import LinkJob, OpenRun, Reply


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
    """Collects what is submitted, until the test answers it."""

    def __init__(self) -> None:
        self.jobs: list[Any] = []
        self.open: list[str] = []
        self._receivers: dict[int, Any] = {}

    def submit(self, job: Any, done: Any) -> None:
        self.jobs.append(job)
        self._receivers[id(job)] = done

    def answer(self, job: Any, value: Any = None, error: Any = None) -> None:
        if isinstance(job, LinkJob) and error is None:
            value = (0.5,) * len(job.tasks)
        self._receivers[id(job)](Reply(value, error, 0.25))

    def of(self, kind: Any, run: str = "r1") -> list[Any]:
        return [job for job in self.jobs if isinstance(job, kind) and job.run == run]

    def open_run(self, opening: OpenRun) -> None:
        self.open.append(opening.context.run)

    def close_run(self, run: str) -> None:
        self.open.remove(run)

    def hastened(self, kind: object, run: str) -> nullcontext[None]:
        return nullcontext()
