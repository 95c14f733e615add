"""All devices of a rig: cameras on their addresses, the chip behind its terminal, the line between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from vaoi_station.rig.devices.camera_wire import CameraWire
from vaoi_station.rig.devices.chip import Chip, build
from vaoi_station.rig.devices.network import Loopback, addresses
from vaoi_station.rig.line.extra_frames import Darkroom, View
from vaoi_station.rig.line.faults import Fault
from vaoi_station.rig.line.films import Film, films
from vaoi_station.rig.line.scenarios import lamp_of
from vaoi_station.rig.line.stage import Mischief, Stage
from vaoi_station.simulation import Scenario

TERMINAL = "trigger"
"""The controller's port, a link in the rig's folder."""


class Devices:
    """A context manager; inside it everything serves, and at its end no process and no address is left.

    Attributes:
        cameras: the wires to the cameras, in the order of the array.
        chip: the controller.
        stage: what moves boards.
    """

    cameras: tuple[CameraWire, ...]
    chip: Chip
    stage: Stage

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        mischief: Mischief | None = None,
        noticed: Callable[[int, int], None] = lambda _board, _row: None,
    ) -> None:
        """`folder` is empty; `noticed` hears of board and row before the cameras are fired."""
        self._scenario, self._folder, self._noticed = scenario, folder, noticed
        self._mischief = mischief or Mischief()
        self._parts = ExitStack()
        self.addresses = addresses(scenario.array.cameras)
        self.terminal = folder / TERMINAL

    def __enter__(self) -> Devices:
        with ExitStack() as parts:
            parts.enter_context(Loopback(self.addresses))
            built = build(self._folder / "firmware")
            self.cameras = tuple(
                CameraWire(address, f"VAOI-{n:02d}", partial(self._answered, n))
                for n, address in enumerate(self.addresses)
            )
            for camera in self.cameras:
                parts.callback(camera.end)
                camera.begin()
            for camera in self.cameras:
                camera.wait()
            self._darkroom = Darkroom(self._scenario, self._folder / "late")
            parts.callback(self._darkroom.close)
            lamp = lamp_of(self._scenario)
            self.stage = Stage(self.cameras, lamp, self._mischief, self._noticed, self._darkroom.develop)
            self.chip = parts.enter_context(Chip(built, self.terminal, self.stage.hear, self.stage.chip_restarted))
            self.stage.use(self.chip)
            self._parts = parts.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._parts.close()

    def lay_calibration_board(self) -> None:
        """Have it rendered as it lies under the cameras while no board passes; else its first pictures come late."""
        self._darkroom.develop(View(None))

    def _answered(self, camera: int, word: str, picture: int, _: int) -> None:
        self.stage.answered(camera, word, picture)


def film_boards(
    scenario: Scenario, faults: Sequence[Fault], boards: int, different: int, folder: Path, tell: Callable[[str], None]
) -> tuple[Film, ...]:
    """The film of every board that passes; with `different` boards in turn, but for those that something befalls."""
    special = {fault.board for fault in faults if fault.kind in ("stuck", "bounce")}
    numbers = [board if board in special else board % different for board in range(boards)]
    distinct = sorted(set(numbers))
    made = dict(zip(distinct, films(scenario, distinct, folder, tell), strict=True))
    return tuple(made[number] for number in numbers)
