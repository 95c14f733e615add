"""`vaoi rig up`: run the devices of a rig for a station that the user starts. Boards pass until Ctrl-C."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from vaoi_station.errors import DeviceError
from vaoi_station.rig.devices.network import entry_command
from vaoi_station.rig.fault_injection import FaultInjector, frame_faults_of
from vaoi_station.rig.line.assembly import Devices, prepare_boards
from vaoi_station.rig.line.faults import Fault, with_belt_faults
from vaoi_station.rig.line.feeder import BoardFeeder
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.scenarios import min_interval_s
from vaoi_station.rig.site import build_site
from vaoi_station.simulation import Scenario


def run_until_interrupted(
    scenario: Scenario,
    faults: tuple[Fault, ...],
    folder: Path,
    cache: Path,
    different: int,
    progress: Callable[[str], None],
    *,
    still: bool = False,
) -> NoReturn:
    """Run the devices until Ctrl-C. At the end all processes are stopped, and only the files in `folder` are left.

    Args:
        scenario: scenario of the twin.
        faults: a fault of a row is injected once; a fault of the belt occurs each time its board passes; others stay
            active.
        folder: a new or empty folder for station.toml, the controller's serial port and the station's data.
        cache: folder in which rendered boards are kept.
        different: number of different boards, which pass in turn.
        progress: called with one line of text.
        still: whether no board passes, so that the cameras show the calibration board.

    Raises:
        KeyboardInterrupt: the user has pressed Ctrl-C.
        DeviceError: the emulator of the chip has ended.
    """
    faulty = with_belt_faults(scenario, faults)
    boards = prepare_boards(faulty, faults, different, different, cache, progress)
    injector = FaultInjector(faults)
    with Devices(faulty, folder, frame_faults_of(faults), injector.on_row) as devices, injector:
        injector.attach(devices)
        progress("Rendering the calibration board.")
        # The frames of the calibration board are rendered now, so that a station that starts at once need not wait.
        devices.lay_calibration_board()
        config = build_site(
            faulty, boards[0], folder, name="rig", addresses=devices.addresses, port=devices.terminal, workers=2
        )
        progress(f"{len(devices.cameras)} cameras at {devices.addresses[0]} …, the controller at {devices.terminal}.")
        progress(f"Start the station: {' '.join([*entry_command(), 'vaoi', 'serve', '--config', str(config)])}")
        if still:
            progress("No board passes: the calibration board lies under the cameras. Press Ctrl-C to stop.")
            _wait_without_boards(devices)
        progress("Boards pass, whether the station is armed or not. Press Ctrl-C to stop.")
        _feed_forever(devices, boards, min_interval_s(scenario, boards))


def _wait_without_boards(devices: Devices) -> NoReturn:
    while devices.chip.alive:
        threading.Event().wait(1.0)
    raise DeviceError("the emulated chip has ended.")


def _feed_forever(devices: Devices, boards: Sequence[RenderedBoard], interval_s: float) -> NoReturn:
    while True:
        # The line counts boards over all rounds of this loop, so a fault of one row happens only once.
        with BoardFeeder(devices.line, boards, interval_s) as feeder:
            while not feeder.finished.wait(1.0):
                pass
        threading.Event().wait(max(interval_s - math.fsum((boards[-1].duration_s, 1.0)), 0.0))
