"""Start all devices of a rig: cameras on their addresses, the chip behind its terminal, the line between them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

from vaoi_station.rig.devices.camera_process import CameraProcess
from vaoi_station.rig.devices.chip import Chip
from vaoi_station.rig.devices.firmware import build
from vaoi_station.rig.devices.network import LoopbackAddresses, addresses
from vaoi_station.rig.line.extra_frames import FrameRenderer, FrameRequest
from vaoi_station.rig.line.faults import Fault
from vaoi_station.rig.line.rendered_boards import RenderedBoard, render_boards
from vaoi_station.rig.line.scenarios import lighting_of
from vaoi_station.rig.line.virtual_line import FrameFaults, VirtualLine
from vaoi_station.simulation import Scenario

TERMINAL = "trigger"
"""Name of the link in the rig's folder that is the controller's serial port."""


class Devices:
    """All devices of a rig; a context manager. At its end no process and no added address is left.

    Attributes:
        cameras: the camera processes, in the order of the array.
        chip: the controller.
        line: lets boards pass.
    """

    cameras: tuple[CameraProcess, ...]
    chip: Chip
    line: VirtualLine

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        frame_faults: FrameFaults | None = None,
        on_row: Callable[[int, int], None] = lambda _board, _row: None,
    ) -> None:
        """Prepare the devices; they start when the context is entered.

        Args:
            scenario: the twin's, with the faults of the belt.
            folder: an empty folder for firmware, terminal and frames.
            frame_faults: what the line does wrong with frames.
            on_row: called with board and row before the cameras are triggered.
        """
        self._scenario, self._folder, self._on_row = scenario, folder, on_row
        self._frame_faults = frame_faults or FrameFaults()
        self._resources = ExitStack()
        self.addresses = addresses(scenario.array.cameras)
        self.terminal = folder / TERMINAL

    def __enter__(self) -> Devices:
        with ExitStack() as resources:
            resources.enter_context(LoopbackAddresses(self.addresses))
            built = build(self._folder / "firmware")
            self.cameras = tuple(
                CameraProcess(address, f"VAOI-{n:02d}", partial(self._on_camera_report, n))
                for n, address in enumerate(self.addresses)
            )
            for camera in self.cameras:
                resources.callback(camera.stop)
                camera.start()
            for camera in self.cameras:
                # All cameras have been started before the first is waited for: each takes half a second.
                camera.wait_ready()
            self._renderer = FrameRenderer(self._scenario, self._folder / "late")
            resources.callback(self._renderer.close)
            lighting = lighting_of(self._scenario)
            self.line = VirtualLine(self.cameras, lighting, self._frame_faults, self._on_row, self._renderer.render)
            self.chip = resources.enter_context(Chip(built, self.terminal, self.line.on_edge, self.line.on_chip_reset))
            self.line.attach_chip(self.chip)
            # Only now nothing can fail any more: before, the local stack ends what has been started.
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def lay_calibration_board(self) -> None:
        """Render the calibration board, which is under the cameras between boards, so that its frames come in time."""
        self._renderer.render(FrameRequest(None))

    def _on_camera_report(self, camera: int, word: str, picture: int, _: int) -> None:
        self.line.on_camera_report(camera, word, picture)


def prepare_boards(
    scenario: Scenario,
    faults: Sequence[Fault],
    boards: int,
    different: int,
    folder: Path,
    progress: Callable[[str], None],
) -> tuple[RenderedBoard, ...]:
    """Return the rendered board of every passage; `different` boards are used in turn.

    A board that a fault of the belt names is rendered on its own: its motion differs.
    """
    affected = {fault.board for fault in faults if fault.kind in ("stuck", "bounce")}
    numbers = [board if board in affected else board % different for board in range(boards)]
    distinct = sorted(set(numbers))
    rendered = dict(zip(distinct, render_boards(scenario, distinct, folder, progress), strict=True))
    return tuple(rendered[number] for number in numbers)
