"""Inject faults into devices and processes at the pulse of a board and row; record which frames may be lost."""

from __future__ import annotations

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from vaoi_station.errors import DeviceError, InternalError
from vaoi_station.rig.line.assembly import Devices
from vaoi_station.rig.line.faults import Fault
from vaoi_station.rig.line.virtual_line import FrameFaults
from vaoi_station.rig.scoring.score import Outage

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
        self._devices: Devices | None = None
        self._processes: Callable[[], Mapping[str, int]] = dict
        self._threads: list[threading.Thread] = []
        self._change, self._closing = threading.Lock(), threading.Event()
        self.outages: list[Outage] = []
        self.recoveries: list[DeviceRecovery] = []
        self.failed: list[str] = []
        """Faults that could not be injected, one sentence each."""

    def set_process_source(self, processes: Callable[[], Mapping[str, int]]) -> None:
        """Set the function that returns the station's processes as {name: process id}."""
        self._processes = processes

    def attach(self, devices: Devices) -> None:
        """Set the devices that faults act on, and start the noise on the serial port if it is one of the faults."""
        self._devices = devices
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
        camera = self._attached_devices().cameras[fault.camera]
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
            # The station may have fewer workers than the fault names. The rig run then fails, because the fault was not
            # tested.
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
        self._attached_devices().chip.send("reset external")
        self._add_outage(Outage(began_ns, OPEN_END_NS, None, "the controller was reset"))
        self._add_recovery(fault, began_ns)

    def close_outage(self, recovery: DeviceRecovery, ready_ns: int) -> None:
        """End the outage of a recovered fault at `ready_ns`, the time since which the station has been ready again."""
        with self._change:
            self.outages = [
                replace(t, until_ns=ready_ns) if (t.from_ns, t.until_ns) == (recovery.began_ns, OPEN_END_NS) else t
                for t in self.outages
            ]

    def _attached_devices(self) -> Devices:
        if self._devices is None:
            raise InternalError("a board passed before the devices were attached.")
        return self._devices

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
