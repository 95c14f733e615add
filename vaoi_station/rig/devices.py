"""All devices of a rig, the files of its station, and the faults that are injected into them."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from vaoi_station.acquisition.ring import RingLayout
from vaoi_station.config import CameraConfig, ControllerConfig, LightConfig, RingConfig, StationConfig
from vaoi_station.demo.station_files import ring_directory, to_toml
from vaoi_station.errors import DeviceError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.files.documents import write_bytes
from vaoi_station.rig.camera_process import CameraProcess
from vaoi_station.rig.chip import Chip, build
from vaoi_station.rig.faults import Fault
from vaoi_station.rig.line import FrameFaults, VirtualLine, lighting_of
from vaoi_station.rig.network import LoopbackAddresses, addresses
from vaoi_station.rig.rendering import FrameRenderer, FrameRequest, RenderedBoard, render_boards
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.simulation.motion.timetable import line_of

TERMINAL = "trigger"


class Devices:
    """All devices of a rig, as a context manager. Its end stops all processes and removes the added addresses."""

    cameras: list[CameraProcess]
    chip: Chip
    line: VirtualLine

    def __init__(
        self,
        scenario: Scenario,
        folder: Path,
        frame_faults: FrameFaults | None = None,
        on_row: Callable[[int, int], None] = lambda _board, _row: None,
        descriptions: Sequence[Path] = (),
    ) -> None:
        """Prepare the devices; they start when the context is entered.

        Args:
            scenario: what the cameras see, and how many there are.
            folder: folder for files of the devices.
            frame_faults: faults of frames.
            on_row: is called for every row before the cameras are triggered.
            descriptions: descriptions that the cameras serve in turn; none: the rig's own.
        """
        self._scenario, self._folder, self._on_row = scenario, folder, on_row
        self._descriptions = tuple(descriptions)
        self._frame_faults = frame_faults or FrameFaults()
        self._resources = ExitStack()
        self.addresses = addresses(scenario.array.cameras)
        self.terminal = folder / TERMINAL

    def __enter__(self) -> Devices:
        with ExitStack() as resources:
            resources.enter_context(LoopbackAddresses(self.addresses))
            built = build(self._folder / "firmware")
            self.cameras = [self._camera(n, address, f"VAOI-{n:02d}") for n, address in enumerate(self.addresses)]
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

    def exchange_camera(self, number: int, address: str, serial: str) -> None:
        """Unplug a camera, and plug in another one at its place, which answers at another address."""
        self.cameras[number].kill()
        other = self._camera(number, address, serial)
        self._resources.callback(other.stop)
        other.start()
        other.wait_ready()
        # The line has the same list.
        self.cameras[number] = other

    def lay_calibration_board(self) -> None:
        """Render frames of the calibration board, which cameras send for pulses fired while no board passes."""
        self._renderer.render(FrameRequest(None))

    def _camera(self, number: int, address: str, serial: str) -> CameraProcess:
        description = self._descriptions[number % len(self._descriptions)] if self._descriptions else None
        sensor_px = self._scenario.array.frame_px(number)
        return CameraProcess(address, serial, partial(self._report, number), sensor_px, description)

    def _report(self, camera: int, word: str, picture: int, _: int) -> None:
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
    """
    affected = {fault.board for fault in faults if fault.kind in ("stuck", "bounce", "follow")}
    numbers = [board if board in affected else board % different for board in range(boards)]
    distinct = sorted(set(numbers))
    rendered = dict(zip(distinct, render_boards(scenario, distinct, folder, progress), strict=True))
    return tuple(rendered[number] for number in numbers)


def build_site(
    scenario: Scenario,
    rendered: RenderedBoard,
    folder: Path,
    *,
    name: str,
    addresses: Sequence[str],
    port: Path,
    workers: int,
    interlock: bool = False,
) -> Path:
    """Write calibration, board type and station.toml into an empty folder; return the path of station.toml."""
    write_calibration(folder / "calibration.json", rendered.calibration)
    write_board_type(folder / "board-types" / f"{rendered.board_type.name}.json", rendered.board_type)
    lighting = lighting_of(scenario)
    config = StationConfig(
        name=name,
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / "data",
        workers=workers,
        line=line_of(scenario),
        cameras=_cameras(scenario, addresses),
        controller=ControllerConfig(
            backend="serial",
            port=str(port),
            lights={
                # LEDs stay on for the longest exposure; cameras with a shorter exposure use a part of this time.
                light: LightConfig(channels=channels, on_us=max(lighting.exposures_us))
                for light, channels in lighting.channels.items()
            },
            order=() if scenario.program else scenario.line.lights,
            interlock="on" if interlock else "off",
        ),
        program=scenario.program,
    )
    directory = ring_directory(RingLayout.of(config).file_bytes, folder)
    config = config.model_copy(update={"ring": RingConfig(directory=directory)})
    path = folder / "station.toml"
    write_bytes(path, to_toml(config).encode())
    return path


def _cameras(scenario: Scenario, addresses: Sequence[str]) -> tuple[CameraConfig, ...]:
    array = scenario.array
    return tuple(
        CameraConfig(
            name=f"camera {n}",
            backend="aravis",
            address=address,
            width=array.frame_px(n)[0],
            height=array.frame_px(n)[1],
            exposure_us=array.exposure_us(n),
            pixel_format="Mono8" if array.bits == 8 else "Mono16",
            nominal_center_mm=head.nominal_center_mm,
            nominal_px_per_mm=head.nominal_px_per_mm,
            nominal_roll_deg=head.nominal_roll_deg,
        )
        for n, (address, head) in enumerate(zip(addresses, Twin(scenario).heads, strict=True))
    )


IN_FLIGHT_S = 0.2
"""Longest time from a pulse to the last packet of its frames, s.

An outage that begins within this time after a pulse may still lose frames of the pulse."""


@dataclass(frozen=True)
class Outage:
    """A period in which frames of one camera, or of all cameras, may be lost because of an injected fault."""

    from_ns: int
    until_ns: int
    camera: int | None
    """Number of the camera; None: all cameras."""
    reason: str

    def covers(self, fired_ns: int, camera: int) -> bool:
        """Return whether this outage may have lost a frame of a camera, fired at `fired_ns` of CLOCK_MONOTONIC."""
        flight_ns = round(IN_FLIGHT_S * 1e9)
        return self.camera in (None, camera) and self.from_ns - flight_ns <= fired_ns <= self.until_ns


OPEN_END_NS = 2**63
"""End time of an outage whose end is not known yet; `close_outage` replaces it."""


_ROW_FAULTS = ("kill", "stall", "reset")


def frame_faults_of(faults: Sequence[Fault]) -> FrameFaults:
    """Return those faults that concern frames: lost packets, ignored pulses, late stamps. The line injects them."""
    return FrameFaults(
        loss=max((f.share for f in faults if f.kind == "loss"), default=0.0),
        ignored=frozenset((f.board, f.row, f.camera) for f in faults if f.kind == "ignored"),
        late_stamps=tuple((f.board, f.camera, f.by_s) for f in faults if f.kind == "stamps"),
    )


@dataclass(frozen=True)
class DeviceRecovery:
    """The end of a fault: the device or process works again, but the station may need more time until it is ready."""

    fault: Fault
    began_ns: int
    """Time of the fault, ns of CLOCK_MONOTONIC. It identifies the outage that the fault has caused."""
    recovered_ns: int


class FaultInjector:
    """Context manager that injects each fault at the pulse of its board and row.

    At the end of the context, stopped processes are resumed at once, and killed cameras are not started again. `on_row`
    runs in the chip's thread, so everything that takes time runs in separate threads.
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._faults = list(faults)
        self._devices: Devices
        self._processes: Callable[[], Mapping[str, int]] = dict
        self._threads: list[threading.Thread] = []
        self._change, self._closing = threading.Lock(), threading.Event()
        self.outages: list[Outage] = []
        self.recoveries: list[DeviceRecovery] = []
        self.failed: list[str] = []

    def attach(self, devices: Devices, processes: Callable[[], Mapping[str, int]] = dict) -> None:
        """Set what faults act on: devices, and the station's processes by name. Start the noise on the serial port."""
        self._devices, self._processes = devices, processes
        for fault in self._faults:
            if fault.kind == "noise":
                devices.chip.send(f"noise {fault.share} {fault.share}")

    def on_row(self, board: int, row: int) -> None:
        """Inject the faults of a row. Called after the pulse of the row and before the cameras are triggered."""
        for fault in [f for f in self._faults if f.kind in _ROW_FAULTS and f.at(board, row)]:
            # The fault is removed first, so that it happens only once even if the row is fired again.
            self._faults.remove(fault)
            {"kill": self._kill, "stall": self._stall, "reset": self._reset}[fault.kind](fault)

    def finish(self) -> None:
        """Wait until the injected faults are over. Record the faults that never happened in `failed`."""
        for thread in self._threads:
            thread.join()
        for fault in self._faults:
            if fault.kind in _ROW_FAULTS:
                self.failed.append(f"{fault.kind} did not happen: board {fault.board} had no row {fault.row}")

    def __enter__(self) -> FaultInjector:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join()

    def _kill(self, fault: Fault) -> None:
        camera = self._devices.cameras[fault.camera]
        began_ns = time.monotonic_ns()
        camera.kill()
        self._add_outage(Outage(began_ns, OPEN_END_NS, fault.camera, "the camera was dead"))

        def restart() -> None:
            # If the rig is stopped meanwhile, the camera is not started again, because no board follows.
            if self._closing.wait(fault.for_s):
                return
            camera.start()
            try:
                camera.wait_ready()
            except DeviceError as error:
                self.failed.append(str(error))
                return
            self._add_recovery(fault, began_ns)

        self._run_aside(restart)

    def _stall(self, fault: Fault) -> None:
        name = "worker 0" if fault.who == "worker" else fault.who
        pid = self._processes().get(name)
        if pid is None:
            # The station has fewer workers than the fault names.
            self.failed.append(f"the station has no process {name!r} to stop")
            return
        began_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGSTOP)

        def resume() -> None:
            self._closing.wait(fault.for_s)
            with contextlib.suppress(ProcessLookupError):  # the station has restarted it in the meantime
                os.kill(pid, signal.SIGCONT)
            # Only the acquisition process receives frames: a stopped station or worker must not lose any.
            if name == "acquisition":
                self._add_outage(Outage(began_ns, OPEN_END_NS, None, "the acquisition process was stopped"))
            self._add_recovery(fault, began_ns)

        self._run_aside(resume)

    def _reset(self, fault: Fault) -> None:
        began_ns = time.monotonic_ns()
        self._devices.chip.send("reset external")
        self._add_outage(Outage(began_ns, OPEN_END_NS, None, "the controller was reset"))
        self._add_recovery(fault, began_ns)

    def close_outage(self, recovery: DeviceRecovery, ready_ns: int) -> None:
        """End the outage of a recovered fault at `ready_ns`, the time since which the station has been ready again."""
        with self._change:
            self.outages = [
                replace(t, until_ns=ready_ns) if (t.from_ns, t.until_ns) == (recovery.began_ns, OPEN_END_NS) else t
                for t in self.outages
            ]

    def _add_outage(self, outage: Outage) -> None:
        with self._change:
            self.outages.append(outage)

    def _add_recovery(self, fault: Fault, began_ns: int) -> None:
        with self._change:
            self.recoveries.append(DeviceRecovery(fault, began_ns, time.monotonic_ns()))

    def _run_aside(self, do: Callable[[], None]) -> None:
        thread = threading.Thread(target=do, name="fault injection")
        self._threads.append(thread)
        thread.start()
