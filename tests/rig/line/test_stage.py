"""Boards before the real firmware on its emulated chip; the cameras' wires end nowhere."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.rig.host import Host
from vaoi_station.acquisition.controller.protocol.messages import Step
from vaoi_station.errors import DeviceError
from vaoi_station.rig.devices.camera_wire import CameraWire
from vaoi_station.rig.devices.chip import HZ, Chip
from vaoi_station.rig.line.extra_frames import View
from vaoi_station.rig.line.feeder import Conveyor
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.scenarios import lamp_of
from vaoi_station.rig.line.stage import Mischief, Stage, wall_clock_ns
from vaoi_station.simulation import Scenario

RING_LIGHT = Step(0b0001, 500)
"""250 us in ticks: as long as the exposure."""


@dataclass
class Line:
    stage: Stage
    chip: Chip
    host: Host
    rows: list[tuple[int, int]]
    """Board and row, as they were noticed."""
    views: list[View]
    """What was asked for that no film has."""


@pytest.fixture
def line(small: Scenario, built: Path, tmp_path: Path) -> Iterator[Line]:
    rows: list[tuple[int, int]] = []
    wires = [CameraWire("127.0.0.2", "A"), CameraWire("127.0.0.3", "B")]
    mischief = Mischief(ignored=frozenset({(0, 2, 1)}))
    views: list[View] = []
    stage = Stage(wires, lamp_of(small), mischief, lambda board, row: rows.append((board, row)), views.append)
    with Chip(built, tmp_path / "trigger", stage.hear, stage.chip_restarted) as chip:
        stage.use(chip)
        with Host(chip.terminal) as host:
            yield Line(stage, chip, host, rows, views)


def test_the_cameras_clock_is_read_without_a_gap_between_two_clocks() -> None:
    """Sixty times, whatever else this computer does: all within what a clock is corrected by meanwhile."""
    now_ns = time.monotonic_ns()
    walls_ns = [wall_clock_ns(now_ns) for _ in range(60)]
    assert max(walls_ns) - min(walls_ns) < 100_000
    assert abs(walls_ns[-1] - (time.time_ns() - time.monotonic_ns() + now_ns)) < 1_000_000_000


def test_every_pulse_comes_when_its_frames_were_rendered_for(
    line: Line, small: Scenario, filmed: tuple[Film, ...]
) -> None:
    line.host.arm(small, (RING_LIGHT,))
    for board, film in enumerate(filmed):
        passing = line.stage.let_pass(film)
        line.host.wait(film.lasts_s + 0.3)
        assert [fired.row for fired in passing.fired] == list(range(film.rows))
        assert max(abs(fired.off_us) for fired in passing.fired) < 1.0
        assert {fired.note for fired in passing.fired} == {""}
        assert all(fired.light == [1.0, 1.0] for fired in passing.fired)
        first_s = (passing.fired[0].shot.host_ns - passing.blocked_ns) * 1e-9
        assert first_s == pytest.approx(small.line.start_delay_s, abs=1e-5)
        assert [row for number, row in line.rows if number == board] == list(range(film.rows))
        ignored = {(2, 1)} if board == 0 else set()
        fates = {(fired.row, n): fate for fired in passing.fired for n, fate in enumerate(fired.fates)}
        assert {cell for cell, fate in fates.items() if fate == "ignored"} == ignored
        assert {fate for cell, fate in fates.items() if cell not in ignored} == {"dead"}
    assert line.stage.strays == []


def test_light_is_what_the_leds_did(line: Line, small: Scenario, filmed: tuple[Film, ...]) -> None:
    """Half as long, on another channel, and not at all."""
    line.host.arm(small, (Step(0b0001, 250), Step(0b0010, 500), Step(0, 0), RING_LIGHT))
    passing = line.stage.let_pass(filmed[0])
    line.host.wait(filmed[0].lasts_s + 0.3)
    assert [fired.light[0] for fired in passing.fired[:4]] == [pytest.approx(0.5, abs=0.002), 0.0, 0.0, 1.0]
    assert [bool(fired.note) for fired in passing.fired[:4]] == [False, True, False, False]
    assert "LED channels (1,) were lit, not those of 'ring'" in passing.fired[1].note


def test_what_no_film_has_is_rendered_when_it_is_asked_for(
    line: Line, small: Scenario, filmed: tuple[Film, ...]
) -> None:
    """Pulses 1 ms later than the film's, and one while nothing passes."""
    late = small.line.model_copy(update={"start_delay_s": small.line.start_delay_s + 0.001})
    line.host.arm(small.model_copy(update={"line": late}), (RING_LIGHT,))
    passing = line.stage.let_pass(filmed[0])
    line.host.wait(filmed[0].lasts_s + 0.3)
    times_s = [t + 0.001 for t in filmed[0].sheet.pulses_s]
    fired = [fired for fired in passing.fired if fired.row is None]
    assert len(fired) == len(passing.fired) > 0
    assert {fate for each in fired for fate in each.fates} == {"late"}
    assert {view.board for view in line.views} == {0}
    assert {view.light for view in line.views} == {"ring"}
    asked_s = sorted(view.time_s for view in line.views)
    assert asked_s == pytest.approx(times_s[: len(asked_s)], abs=1e-6)


def test_after_a_reset_the_barrier_still_follows_the_board(
    line: Line, small: Scenario, filmed: tuple[Film, ...]
) -> None:
    """The board leaves it at the cycle it would have: the next one is seen."""
    line.host.arm(small, (RING_LIGHT,))
    passing = line.stage.let_pass(filmed[0])
    line.host.wait(0.5)
    line.chip.tell("reset external")
    line.host.wait(filmed[0].lasts_s)
    fired = len(passing.fired)
    assert fired < filmed[0].rows
    line.host.arm(small, (RING_LIGHT,))
    again = line.stage.let_pass(filmed[1])
    line.host.wait(filmed[1].lasts_s + 0.3)
    assert [shot.row for shot in again.fired] == list(range(filmed[1].rows))
    assert max(abs(shot.off_us) for shot in again.fired) < 1.0
    assert again.start_cycle - passing.start_cycle > filmed[0].lasts_s * HZ


def test_a_chip_that_has_ended_ends_the_boards(line: Line, filmed: tuple[Film, ...]) -> None:
    """Whoever waits for them hears why, and does not wait for ever."""
    os.kill(line.chip.pid, signal.SIGKILL)
    os.waitid(os.P_PID, line.chip.pid, os.WEXITED | os.WNOWAIT)
    with pytest.raises(DeviceError, match="the emulated chip has ended"), Conveyor(line.stage, filmed, 0.1) as conveyor:
        assert conveyor.empty.wait(30)
    assert conveyor.passed == []
