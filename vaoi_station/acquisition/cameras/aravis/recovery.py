"""What is tried with a camera that hangs, in which order, how often, and the command that switches its power.

A camera hangs if it answers but sends nothing of a board that other cameras filmed, or if it does not answer although
its link is up. Each step has the time that the camera gets afterwards, and a number of times per hour.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

from vaoi_station.acquisition.cameras.interface import CameraRecovery
from vaoi_station.config import CameraPowerConfig

HOUR_S = 3600.0
ABSENT_LIMIT_S = 30.0
"""Time for which a camera does not answer although its link is up, before its power is switched."""


@dataclass(frozen=True)
class Step:
    """One step against a camera that hangs."""

    code: str
    done: str
    """What was done, for messages."""
    time_s: float
    """Time that the camera gets before the next step."""
    most: int
    """How often it is taken within an hour."""


REOPEN = Step("reopen", "it was opened again", 2.0, 2)
RESTART = Step("restart", "its stream was started again", 2.0, 2)
RESET = Step("reset", "it was reset (DeviceReset)", 30.0, 2)
POWER = Step("power", "its power was switched off and on", 90.0, 2)
STEPS = (REOPEN, RESTART, RESET, POWER)
SPENT = "spent"
"""Code of the state in which all steps were taken."""


class Recovery:
    """The steps that were taken with one camera since it filmed last. One thread takes them, any may read them."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin without a step."""
        self._clock = clock
        self._taken: list[tuple[float, Step]] = []
        self._next = 0
        self.state: CameraRecovery | None = None
        """The latest step; None while the camera films."""

    def next_step(self, possible: Collection[Step]) -> Step | None:
        """Take the next possible step with a camera that answers and sent nothing.

        None while the latest one has its time, or if all were taken as often as permitted.
        """
        if self._has_time():
            return None
        for number in range(len(STEPS)):
            step = STEPS[(self._next + number) % len(STEPS)]
            if step in possible and self.take(step, "silent"):
                self._next = STEPS.index(step) + 1
                return step
        state = self.state  # read once: a frame may end it at any time
        if state is not None and state.step != SPENT:
            self.state = CameraRecovery(SPENT, "silent", self._clock())
        return None

    def take(self, step: Step, why: str) -> bool:
        """Record a step for which there is time and leave; return whether there is."""
        now_s = self._clock()
        self._taken = [(at_s, taken) for at_s, taken in self._taken if now_s - at_s < HOUR_S]
        if self._has_time() or sum(taken is step for _, taken in self._taken) >= step.most:
            return False
        self._taken.append((now_s, step))
        self.state = CameraRecovery(step.code, why, now_s)
        return True

    def filmed(self) -> None:
        """Forget what was tried: the camera sent a frame. How often a step was taken within the hour still counts."""
        self._next, self.state = 0, None

    def _has_time(self) -> bool:
        return bool(self._taken) and self._clock() - self._taken[-1][0] < self._taken[-1][1].time_s

    def message(self) -> str:
        """Return what is wrong and what was done, for the camera's status; empty while it films."""
        state = self.state  # read once: a frame may end it at any time
        if state is None:
            return ""
        what = "Sent nothing of the last board" if state.why == "silent" else "Did not answer"
        if state.step == SPENT:
            return f"{what}; everything was tried. Check its trigger wire, its cable and its power, or exchange it."
        done = next(step.done for step in STEPS if step.code == state.step)
        return f"{what}; {done}. The next board shows whether that helped."


END_S = 5.0
"""Time that a command gets to switch the power on again and to end, once its own time has passed."""


def switch_power(config: CameraPowerConfig, named: dict[str, str]) -> str:
    """Run the administrator's command for one camera; return what went wrong, empty if nothing did.

    `named` is what stands for {name}, {address} and {serial} in its arguments. The end of the station does not end the
    command: the power would stay off.
    """
    words = list(config.command)
    for name, value in named.items():
        words[1:] = [word.replace(f"{{{name}}}", value) for word in words[1:]]
    with tempfile.TemporaryFile() as output:
        try:
            process = subprocess.Popen(
                words, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
            )
        except OSError as error:
            return f"{words[0]} cannot be run ({error.strerror})"
        for end, limit_s in ((None, config.limit_s), (signal.SIGTERM, END_S), (signal.SIGKILL, None)):
            if end is not None:
                os.killpg(process.pid, end)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(limit_s)
                break
        if end is not None:
            return f"{words[0]} did not end within {config.limit_s:g} s (camera_power.limit_s)"
        if process.returncode == 0:
            return ""
        output.seek(0)
        said = output.read(2000).decode(errors="replace").strip().splitlines()
        return f"{words[0]} ended with code {process.returncode}{f': {said[-1][:200]}' if said else ''}"
