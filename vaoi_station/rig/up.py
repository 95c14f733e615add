"""`vaoi rig up`: devices for a station that somebody starts beside them; boards keep passing until Ctrl-C."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NoReturn

from vaoi_station.errors import DeviceError
from vaoi_station.rig.devices.network import entrance
from vaoi_station.rig.fault_injection import Saboteur, mischief_of
from vaoi_station.rig.line.assembly import Devices, film_boards
from vaoi_station.rig.line.faults import Fault, befallen
from vaoi_station.rig.line.feeder import Conveyor
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.scenarios import least_interval_s
from vaoi_station.rig.site import build_site
from vaoi_station.simulation import Scenario


def keep_up(
    scenario: Scenario,
    faults: tuple[Fault, ...],
    folder: Path,
    films: Path,
    different: int,
    tell: Callable[[str], None],
    *,
    still: bool = False,
) -> NoReturn:
    """Ends by KeyboardInterrupt, with everything put away but the folder; by DeviceError if the chip's emulator ends.

    Args:
        scenario: of the twin.
        faults: those that name a board befall it once, others last.
        folder: new or empty; station.toml, the controller's port and the station's data will be there.
        films: where films are kept.
        different: boards that are filmed, and pass in turn.
        tell: takes one line.
        still: no board passes; the calibration board lies under the cameras.
    """
    plagued = befallen(scenario, faults)
    boards = film_boards(plagued, faults, different, different, films, tell)
    saboteur = Saboteur(faults)
    with Devices(plagued, folder, mischief_of(faults), saboteur.noticed) as devices, saboteur:
        saboteur.use(devices)
        tell("Laying the calibration board under the cameras.")
        devices.lay_calibration_board()
        config = build_site(
            plagued, boards[0], folder, name="rig", addresses=devices.addresses, port=devices.terminal, workers=2
        )
        tell(f"{len(devices.cameras)} cameras at {devices.addresses[0]} …, the controller at {devices.terminal}.")
        tell(f"Start the station: {' '.join([*entrance(), 'vaoi', 'serve', '--config', str(config)])}")
        if still:
            tell("No board passes: the calibration board lies under the cameras. Ctrl-C ends it.")
            _lie_still(devices)
        tell("Boards pass, whether somebody films them or not. Ctrl-C ends it.")
        _let_pass(devices, boards, least_interval_s(scenario, boards))


def _lie_still(devices: Devices) -> NoReturn:
    while devices.chip.alive:
        threading.Event().wait(1.0)
    raise DeviceError("the emulated chip has ended.")


def _let_pass(devices: Devices, boards: Sequence[Film], interval_s: float) -> NoReturn:
    while True:
        with Conveyor(devices.stage, boards, interval_s) as conveyor:
            while not conveyor.empty.wait(1.0):
                pass
        threading.Event().wait(max(interval_s - math.fsum((boards[-1].lasts_s, 1.0)), 0.0))
