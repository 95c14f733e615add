"""Runs `vaoi doctor` for callers, in a process of its own: its libraries do not stay in the station's memory."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
import time
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Literal

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field, model_validator

from vaoi_station.api.limits import Seats, caller_of
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import DeviceError, NotFoundError

LIMIT_S = 60.0
"""Longest time of an examination."""
KEPT_S = 10.0
"""Time for which an answer, or a failure, is given again, so that several pages cause one examination."""
LOWEST_PRIORITY = 19
WAITING, WAITING_OF_CALLER = 32, 8
"""Limits of requests that wait for an examination, in total and of one caller."""
DOCTOR = (sys.executable, "-m", "vaoi_station", "doctor", "--json", "--config")


class ExaminationFinding(BaseModel):
    """One finding of `vaoi doctor`."""

    model_config = ConfigDict(frozen=True)

    check: str
    subject: str
    """The camera, file or port that it concerns; empty: the station."""
    level: Literal["ok", "warning", "fault", "not-applicable"]
    code: str = ""
    """What is wrong; empty without a problem."""
    message: str
    action: str
    """The step that solves the problem; empty without a problem."""
    figures: dict[str, float] = Field(default_factory=dict)
    """Measured values, with units in the names."""
    names: dict[str, str] = Field(default_factory=dict)
    """Files and other names that the message states, by what they are."""

    @model_validator(mode="before")
    @classmethod
    def _divided(cls, finding: dict[str, Any]) -> dict[str, Any]:
        # The doctor has one object for both; clients in typed languages need one type per field.
        figures = finding.get("figures", {})
        numbers = {name: value for name, value in figures.items() if isinstance(value, int | float)}
        return finding | {"figures": numbers, "names": {n: v for n, v in figures.items() if isinstance(v, str)}}


class Examination(BaseModel):
    """All findings of `vaoi doctor`, in the order of its checks."""

    model_config = ConfigDict(frozen=True)

    created: str
    worst: Literal["ok", "warning", "fault", "not-applicable"]
    findings: tuple[ExaminationFinding, ...]


class Examinations:
    """Examines the station of a station.toml, one examination at a time. Callers wait for it without a thread."""

    def __init__(
        self, config: Path | None, closing: Callable[[], Awaitable[object]], doctor: Sequence[str] = DOCTOR
    ) -> None:
        """Prepare examinations.

        Args:
            config: the station.toml; None if the station does not know it.
            closing: waits until the station stops; the process of an examination is ended then.
            doctor: the command to which the path of the station.toml is added.
        """
        self._config, self._closing, self._doctor = config, closing, tuple(doctor)
        self._latest: asyncio.Task[Examination | str] | None = None
        self._ended_s = 0.0

    async def examine(self) -> Examination:
        """Return all findings. Callers that come during an examination, or soon after it, get the same answer.

        Raises:
            NotFoundError: the station does not know its station.toml.
            DeviceError: the examination has failed.
        """
        if self._config is None:
            raise NotFoundError(
                "This station was started without a station.toml, which vaoi doctor needs.",
                action="Start it by vaoi serve --config station.toml.",
                code="not-examinable",
            )
        task = self._latest
        if task is None or (task.done() and time.monotonic() - self._ended_s > KEPT_S):
            task = self._latest = asyncio.create_task(self._examine(self._config))
        # The examination goes on for the other callers if this one has gone.
        found = await asyncio.shield(task)
        if isinstance(found, str):
            raise DeviceError(
                f"vaoi doctor did not examine the station: {found}.",
                action=f"Run vaoi doctor --config {self._config} on the station's machine.",
                code="examination-failed",
            )
        return found

    async def _examine(self, config: Path) -> Examination | str:
        """Run the doctor; return its findings, or why there are none."""
        try:
            # A session of its own, so that what the doctor has started is ended with it.
            process = await asyncio.create_subprocess_exec(
                "nice", "-n", str(LOWEST_PRIORITY), *self._doctor, str(config), stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.DEVNULL, start_new_session=True,
            )  # fmt: skip
            output, closing = asyncio.create_task(process.communicate()), asyncio.ensure_future(self._closing())
            try:
                await asyncio.wait({output, closing}, timeout=LIMIT_S, return_when=asyncio.FIRST_COMPLETED)
                if output.done():
                    return Examination.model_validate_json(output.result()[0])
                return "the station is stopping" if closing.done() else f"it took longer than {LIMIT_S:g} s"
            finally:
                closing.cancel()
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                await process.wait()
                output.cancel()
        except (OSError, ValueError) as error:
            return type(error).__name__
        finally:
            self._ended_s = time.monotonic()


def router(services: Services, config: Path | None) -> APIRouter:
    """Create the route; `config` is the station.toml that the doctor examines."""
    routes, examinations = rest_router(tags=["station"]), Examinations(config, services.hub.closing)
    seats = Seats("requests for an examination that wait", WAITING, WAITING_OF_CALLER)

    @routes.get("/doctor")
    async def examine_station(request: Request) -> Examination:
        """Run `vaoi doctor` on the station's machine and return its findings; it changes nothing and takes seconds.

        An answer or failure of the last 10 s is given again. 404 `not-examinable`: the station has no station.toml.
        """
        with seats.take(caller_of(request).name):
            return await examinations.examine()

    return routes
