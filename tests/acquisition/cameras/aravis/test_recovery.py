"""The steps against a camera that hangs, their times and limits, and the command for its power."""

from __future__ import annotations

import os
import time
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config
from vaoi_station.acquisition.cameras.aravis.camera import AravisCamera, Unopened
from vaoi_station.acquisition.cameras.aravis.recovery import (
    POWER,
    REOPEN,
    RESET,
    RESTART,
    STEPS,
    Recovery,
    Step,
    switch_power,
)
from vaoi_station.config import CameraPowerConfig
from vaoi_station.errors import DeviceError


class Clock:
    """A clock that a test sets."""

    now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def steps(recovery: Recovery, clock: Clock, count: int, possible: tuple[Step, ...] = STEPS) -> list[Step | None]:
    """Return the steps of boards that come two minutes apart and show nothing of the camera."""
    found = []
    for _ in range(count):
        found.append(recovery.next_step(possible))
        clock.now_s += 120.0
    return found


def test_every_board_without_a_frame_leads_to_the_next_step_until_each_was_tried_twice() -> None:
    clock = Clock()
    recovery = Recovery(clock)
    assert steps(recovery, clock, 10) == [REOPEN, RESTART, RESET, POWER] * 2 + [None, None]
    assert recovery.message().startswith("Sent nothing of the last board; everything was tried.")
    clock.now_s += 3600.0
    assert recovery.next_step(STEPS) is REOPEN, "an hour later it is tried again"


class FilmingAgain(Recovery):
    """A camera of which a frame comes, in another thread, as soon as its state was read."""

    def __getattribute__(self, name: str) -> Any:
        value = super().__getattribute__(name)
        if name == "state" and value is not None:
            self.filmed()
        return value


def test_a_frame_may_come_while_the_state_is_looked_at() -> None:
    clock = Clock()
    recovery = FilmingAgain(clock)
    recovery.next_step(STEPS)
    assert recovery.message().startswith("Sent nothing of the last board; it was opened again.")
    assert recovery.message() == ""
    recovery.take(POWER, "silent")
    clock.now_s += POWER.time_s
    assert recovery.next_step(()) is None


def test_a_camera_gets_the_time_of_a_step_before_the_next_one() -> None:
    clock = Clock()
    recovery = Recovery(clock)
    assert recovery.next_step((RESET, POWER)) is RESET
    clock.now_s += RESET.time_s - 0.1
    assert recovery.next_step((RESET, POWER)) is None
    assert recovery.message() == (
        "Sent nothing of the last board; it was reset (DeviceReset). The next board shows whether that helped."
    )
    clock.now_s += 0.2
    assert recovery.next_step((RESET, POWER)) is POWER


def test_a_frame_ends_the_trouble_and_later_trouble_begins_with_the_first_step() -> None:
    clock = Clock()
    recovery = Recovery(clock)
    assert steps(recovery, clock, 2, (REOPEN, RESTART)) == [REOPEN, RESTART]
    recovery.filmed()
    assert (recovery.state, recovery.message()) == (None, "")
    assert steps(recovery, clock, 3, (REOPEN, RESTART)) == [REOPEN, RESTART, None]


def test_power_is_switched_for_a_deaf_camera_twice_an_hour() -> None:
    clock = Clock()
    recovery = Recovery(clock)
    taken = []
    for _ in range(6):
        taken.append(recovery.take(POWER, "absent"))
        clock.now_s += 60.0
    assert taken == [True, False, True, False, False, False]
    assert recovery.message().startswith("Did not answer; its power was switched off and on.")


NAMES = {"name": "left", "address": "10.0.0.1", "serial": "S 1; rm x"}


def command(tmp_path: Path, *words: str, limit_s: float = 20.0) -> CameraPowerConfig:
    program = tmp_path / "power"
    program.write_text("#!/bin/sh\n" + "\n".join(words) + "\n")
    program.chmod(0o755)
    content = {"command": (str(program), "--camera={name}", "{serial}"), "limit_s": limit_s}
    return CameraPowerConfig.model_validate(content)


def test_the_command_gets_the_camera_as_arguments_and_no_shell_reads_them(tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert switch_power(command(tmp_path, f'printf "%s|" "$@" > {out}'), NAMES) == ""
    assert out.read_text() == "--camera=left|S 1; rm x|"


def test_a_command_that_fails_is_reported_with_its_last_words(tmp_path: Path) -> None:
    failing = command(tmp_path, "echo first", "echo port 7 is unknown >&2", "exit 3")
    assert switch_power(failing, NAMES).endswith("ended with code 3: port 7 is unknown")
    absent = CameraPowerConfig(command=("/nowhere/power",))
    assert switch_power(absent, NAMES) == "/nowhere/power cannot be run (No such file or directory)"


def test_a_command_that_does_not_end_is_ended_with_all_that_it_started(tmp_path: Path) -> None:
    before_s = time.monotonic()
    endless = command(tmp_path, "sleep 600 & wait", limit_s=0.3)
    assert switch_power(endless, NAMES).endswith("did not end within 0.3 s (camera_power.limit_s)")
    assert time.monotonic() - before_s < 20


def test_a_command_that_takes_too_long_may_switch_the_power_on_before_it_ends(tmp_path: Path) -> None:
    on = tmp_path / "on"
    slow = command(tmp_path, f"trap 'touch {on}; exit 1' TERM", "sleep 600 & wait", limit_s=0.3)
    assert "did not end within" in switch_power(slow, NAMES)
    assert on.exists()


def test_the_end_of_the_station_waits_for_the_command(tmp_path: Path) -> None:
    """Ended half-way, it would leave the camera without power."""
    begun, on = tmp_path / "begun", tmp_path / "on"
    os.mkfifo(begun)
    power = command(tmp_path, f"echo > {begun}", "sleep 0.5", f"touch {on}")
    config = camera_config(address="127.0.0.99")
    camera = AravisCamera(0, Unopened(config, DeviceError("gone", code="camera-absent")), power)
    camera._power_is_due = True
    camera.start(SimpleQueue())
    begun.read_text()  # waits until the command writes
    camera.close()
    assert on.exists()


def test_a_command_is_named_by_its_whole_path() -> None:
    with pytest.raises(ValueError, match="must begin with an absolute path"):
        CameraPowerConfig(command=("poe-cycle", "{name}"))
