"""Does what the faults say, when the board and row they name are fired, and remembers what may be lost by it."""

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
from vaoi_station.rig.line.stage import Mischief
from vaoi_station.rig.scoring.score import Trouble

FOREVER_NS = 2**63
"""Until the station is ready again, which is told by `mend`."""


_AT_A_ROW = ("kill", "stall", "reset")


def mischief_of(faults: Sequence[Fault]) -> Mischief:
    """What the stage does by itself."""
    return Mischief(
        loss=max((f.share for f in faults if f.kind == "loss"), default=0.0),
        ignored=frozenset((f.board, f.row, f.camera) for f in faults if f.kind == "ignored"),
    )


@dataclass(frozen=True)
class Back:
    """A device works again."""

    fault: Fault
    began_ns: int
    back_ns: int


class Saboteur:
    """Hears of every row in the chip's thread; what takes time is done in threads of its own.

    A context manager: at its end what was stopped runs on, and nothing is put back any more.
    """

    def __init__(self, faults: Sequence[Fault]) -> None:
        self._faults = list(faults)
        self._devices: Devices | None = None
        self._processes: Callable[[], Mapping[str, int]] = dict
        self._threads: list[threading.Thread] = []
        self._change, self._closing = threading.Lock(), threading.Event()
        self.troubles: list[Trouble] = []
        self.backs: list[Back] = []
        self.failed: list[str] = []

    def ask_for_processes(self, processes: Callable[[], Mapping[str, int]]) -> None:
        """How to learn of the station's processes: name → pid."""
        self._processes = processes

    def use(self, devices: Devices) -> None:
        """The rig to do it to."""
        self._devices = devices
        for fault in self._faults:
            if fault.kind == "noise":
                devices.chip.tell(f"noise {fault.share} {fault.share}")

    def noticed(self, board: int, row: int) -> None:
        """The pulse of a row has been fired; no camera has heard of it."""
        for fault in [f for f in self._faults if f.kind in _AT_A_ROW and f.at(board, row)]:
            self._faults.remove(fault)
            {"kill": self._kill, "stall": self._stall, "reset": self._reset}[fault.kind](fault)

    def over(self) -> None:
        """Wait for what is under way, and complain of what never happened."""
        for thread in self._threads:
            thread.join()
        for fault in self._faults:
            if fault.kind in _AT_A_ROW:
                self.failed.append(f"{fault.kind} did not happen: board {fault.board} had no row {fault.row}")

    def __enter__(self) -> Saboteur:
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join()

    def _kill(self, fault: Fault) -> None:
        camera = self._at_work().cameras[fault.camera]
        began_ns = time.monotonic_ns()
        camera.kill()
        self._remember(Trouble(began_ns, FOREVER_NS, fault.camera, "the camera was dead"))

        def put_back() -> None:
            if self._closing.wait(fault.for_s):
                return
            camera.begin()
            try:
                camera.wait()
            except DeviceError as error:
                self.failed.append(str(error))
                return
            self._back(fault, began_ns)

        self._later(put_back)

    def _stall(self, fault: Fault) -> None:
        name = "worker 0" if fault.who == "worker" else fault.who
        pid = self._processes().get(name)
        if pid is None:
            self.failed.append(f"the station has no process {name!r} to stop")
            return
        began_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGSTOP)

        def let_run() -> None:
            self._closing.wait(fault.for_s)
            with contextlib.suppress(ProcessLookupError):  # the station has given it up and started another
                os.kill(pid, signal.SIGCONT)
            if name == "acquisition":
                self._remember(Trouble(began_ns, FOREVER_NS, None, "the acquisition process was stopped"))
            self._back(fault, began_ns)

        self._later(let_run)

    def _reset(self, fault: Fault) -> None:
        began_ns = time.monotonic_ns()
        self._at_work().chip.tell("reset external")
        self._remember(Trouble(began_ns, FOREVER_NS, None, "the controller was reset"))
        self._back(fault, began_ns)

    def mend(self, back: Back, ready_ns: int) -> None:
        """The station has been ready since then: from then on nothing may be lost by this fault."""
        with self._change:
            self.troubles = [
                replace(t, until_ns=ready_ns) if (t.from_ns, t.until_ns) == (back.began_ns, FOREVER_NS) else t
                for t in self.troubles
            ]

    def _at_work(self) -> Devices:
        if self._devices is None:
            raise InternalError("a board passed before the rig was put together.")
        return self._devices

    def _remember(self, trouble: Trouble) -> None:
        with self._change:
            self.troubles.append(trouble)

    def _back(self, fault: Fault, began_ns: int) -> None:
        with self._change:
            self.backs.append(Back(fault, began_ns, time.monotonic_ns()))

    def _later(self, do: Callable[[], None]) -> None:
        thread = threading.Thread(target=do, name="sabotage")
        self._threads.append(thread)
        thread.start()
