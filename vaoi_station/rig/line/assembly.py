"""Start all devices of a rig: the camera processes, the emulated chip, and the virtual line that connects them."""

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
"""Name of the symbolic link, in the rig's folder, that a station opens as the controller's serial port."""


class Devices:
    """All devices of a rig, as a context manager. Its end stops all processes and removes the added addresses.

    Attributes:
        cameras: the camera processes, in the order of the array.
        chip: the emulated controller.
        line: the virtual line, which lets boards pass.
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
            scenario: scenario of the twin, including the faults of the belt.
            folder: an empty folder for the firmware, the serial port and frames that are rendered on demand.
            frame_faults: faults that the line injects into frames.
            on_row: called with board and row at each pulse, before the cameras are triggered.
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
                # All cameras are started before the first wait, because each takes half a second to start.
                camera.wait_ready()
            self._renderer = FrameRenderer(self._scenario, self._folder / "late")
            resources.callback(self._renderer.close)
            lighting = lighting_of(self._scenario)
            self.line = VirtualLine(self.cameras, lighting, self._frame_faults, self._on_row, self._renderer.render)
            self.chip = resources.enter_context(Chip(built, self.terminal, self.line.on_edge, self.line.on_chip_reset))
            self.line.attach_chip(self.chip)
            # Until here a failure unwinds the local stack, which stops all devices that have been started.
            self._resources = resources.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._resources.close()

    def lay_calibration_board(self) -> None:
        """Render frames of the calibration board, which cameras send for pulses fired while no board passes."""
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
    """Return the rendered board of every passage, and render those that are missing.

    A board with a fault of the belt is rendered separately, because its motion differs from that of other boards.

    Args:
        scenario: scenario of the twin, including the faults of the belt.
        faults: all faults of the rig run.
        boards: number of passages.
        different: number of different boards, which are used in turn.
        folder: where rendered boards are kept.
        progress: called with one line of text.
    """
    affected = {fault.board for fault in faults if fault.kind in ("stuck", "bounce", "follow")}
    numbers = [board if board in affected else board % different for board in range(boards)]
    distinct = sorted(set(numbers))
    rendered = dict(zip(distinct, render_boards(scenario, distinct, folder, progress), strict=True))
    return tuple(rendered[number] for number in numbers)
