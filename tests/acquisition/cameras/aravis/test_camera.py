"""A camera survives the loss of its connection: slots wait, the loss is reported, and a new connection gets them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import TypeVar

import numpy as np
import pytest

from tests.acquisition.cameras.aravis.stand_in import camera_config, station_config
from vaoi_station.acquisition.cameras.aravis import camera as camera_module
from vaoi_station.acquisition.cameras.aravis.camera import AravisCamera, Unopened
from vaoi_station.acquisition.cameras.aravis.connection import Connection, Identity, PortShare
from vaoi_station.acquisition.cameras.aravis.stream import SlotResult
from vaoi_station.acquisition.cameras.interface import (
    CameraBack,
    CameraEvent,
    CameraExposure,
    CameraLimits,
    CameraLost,
    CameraPtp,
    Slot,
)
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.backoff import BackoffPolicy
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.supervised_thread import SupervisedThread

SLOTS = [Slot(number, np.zeros(32, np.uint8)) for number in range(4)]
EPOCH_S = 5.0
E = TypeVar("E")


class StandInStream:
    """The slots that were queued, in their order."""

    def __init__(self) -> None:
        self.queued: list[Slot] = []

    def queue(self, slot: Slot) -> None:
        self.queued.append(slot)

    def take_back(self) -> list[Slot]:
        unused, self.queued = self.queued, []
        return unused

    close = take_back


class StandInConnection:
    """A USB camera; `error` is raised by each access to it."""

    made: list[StandInConnection]
    serial = "S1"
    refusal: DeviceError | None = None
    """Raised by `configure`."""

    def __init__(
        self,
        config: CameraConfig,
        where: str,
        sequence: tuple[tuple[float, float], ...] = (),
        share: PortShare = PortShare(),  # noqa: B008
    ) -> None:
        self.config, self.where, self.sequence, self.share = config, where, sequence, share
        self.rewound, self.limits = 0, CameraLimits()
        self.identity = Identity(self.serial, where, "")
        self.is_gige = False
        self.stream = StandInStream()
        self.error: DeviceError | None = None
        self.controlled = True
        self.closed: list[bool] = []
        self.on_slot: Callable[[SlotResult], None] = lambda _result: None
        self.made.append(self)

    require_serial = Connection.require_serial

    def configure(self) -> None:
        if self.refusal is not None:
            raise self.refusal

    def start(self, on_slot: Callable[[SlotResult], None]) -> None:
        self.on_slot = on_slot

    ptp: CameraPtp | None = None

    def read_ptp(self) -> None:
        """Do nothing: it has no PTP."""

    def await_ptp(self, _closing: threading.Event) -> None:
        """Do nothing: it has no PTP."""

    def read_clock(self, epoch_ns: int) -> ClockReading:
        if self.error is not None:
            raise self.error
        return ClockReading(EPOCH_S - epoch_ns * 1e-9, time.monotonic(), 0.0)

    exposure_refusal: DeviceError | None = None
    slow_exposure: Callable[[], object] | None = None
    """Called while an exposure is written."""
    n_exposures = 0

    def has_exposure(self, wanted: CameraConfig, sequence: tuple[tuple[float, float], ...]) -> bool:
        return (self.config, self.sequence) == (wanted, sequence)

    def set_exposure(self, wanted: CameraConfig, sequence: tuple[tuple[float, float], ...]) -> None:
        self.n_exposures += 1
        if self.slow_exposure is not None:
            self.slow_exposure()
        if self.exposure_refusal is not None:
            raise self.exposure_refusal
        self.config, self.sequence = wanted, sequence

    def rewind(self) -> None:
        if self.error is not None:
            raise self.error
        self.rewound += 1

    def temperature_c(self) -> float:
        return 41.5

    def is_controller(self) -> bool:
        return self.controlled

    def threads(self) -> tuple[SupervisedThread, ...]:
        return (SupervisedThread(lambda: None, "frames"),)

    def counters(self) -> dict[str, int]:
        return {"n_underruns": 3}

    def warning(self) -> str:
        return "small buffer"

    def close(self, *, gone: bool = False) -> None:
        self.closed.append(gone)


class Bench:
    """A camera, its present connection and what it reported."""

    def __init__(self) -> None:
        self.events: SimpleQueue[CameraEvent] = SimpleQueue()
        config = camera_config(address=None, serial="S1")
        connection = StandInConnection(config, "USB-1")
        self.camera = AravisCamera(0, connection)  # type: ignore[arg-type]

    @property
    def connection(self) -> StandInConnection:
        return StandInConnection.made[-1]

    def next(self, kind: type[E]) -> E:
        while not isinstance(event := self.events.get(timeout=10), kind):
            pass
        return event

    def wait(self, condition: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + 10
        while not condition():
            assert time.monotonic() < deadline_s

    def lose(self) -> CameraLost:
        """Fail a clock reading, from which the supervisor concludes that the camera is lost."""
        self.connection.error = DeviceError("camera c0: does not report its time.", code="camera-lost")
        with pytest.raises(DeviceError):
            self.camera.read_clock()
        return self.next(CameraLost)


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    StandInConnection.made = []
    monkeypatch.setattr(StandInConnection, "serial", "S1")
    monkeypatch.setattr(StandInConnection, "refusal", None)
    monkeypatch.setattr(camera_module, "Connection", StandInConnection)
    monkeypatch.setattr(camera_module, "locate", lambda _cameras: ["USB-2"])
    monkeypatch.setattr(camera_module, "CHECK_S", 0.01)
    monkeypatch.setattr(camera_module, "ABSENT_S", 0.02)
    monkeypatch.setattr(camera_module, "PACE", BackoffPolicy(first_s=0.01, longest_s=30.0, proven_s=10.0))
    bench = Bench()
    yield bench
    bench.camera.close()


def test_slots_wait_for_the_camera_in_their_order(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StandInConnection, "refusal", DeviceError("is absent", code="camera-absent"))
    bench.camera.start(bench.events)
    for slot in SLOTS[:2]:
        bench.camera.queue(slot)
    bench.lose()
    for slot in SLOTS[2:]:
        bench.camera.queue(slot)
    monkeypatch.setattr(StandInConnection, "refusal", None)
    bench.next(CameraBack)
    bench.wait(lambda: bench.camera.health().connected)
    assert bench.connection.stream.queued == SLOTS


def test_another_camera_in_its_place_is_not_taken(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(StandInConnection, "serial", "S9")
    bench.camera.start(bench.events)
    bench.lose()
    bench.wait(lambda: "S9" in bench.camera.health().message)
    assert not bench.camera.health().connected


@pytest.mark.parametrize("lost", [True, False])
def test_a_camera_that_was_exchanged_is_opened_in_its_place_with_its_settings(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, lost: bool
) -> None:
    bench.camera.start(bench.events)
    bench.camera.set_exposure(CameraExposure((77.0,), 3.0))
    monkeypatch.setattr(StandInConnection, "serial", "S9")
    if lost:
        bench.lose()
    bench.camera.replace("S9", "USB-9")
    if not lost:
        assert "another camera, S9" in bench.next(CameraLost).why
    bench.next(CameraBack)
    health = bench.camera.health()
    assert (health.connected, health.serial) == (True, "S9")
    assert (bench.connection.config.serial, bench.connection.config.exposure_us) == ("S9", 77.0)


def test_an_exposure_that_is_set_while_the_camera_is_opened_comes_before_its_slots(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.camera.set_exposure(CameraExposure((900.0,), 6.0))
    bench.camera.start(bench.events)
    exposed: list[float] = []

    def arm_meanwhile(connection: StandInConnection) -> None:
        bench.camera.set_exposure(CameraExposure((80.0,), 0.0))
        bench.camera.queue(SLOTS[0])

        def note(slot: Slot) -> None:
            del slot
            exposed.append(connection.config.exposure_us)

        connection.stream.queue = note  # type: ignore[method-assign]

    monkeypatch.setattr(StandInConnection, "configure", arm_meanwhile)
    bench.lose()
    bench.next(CameraBack)
    bench.wait(lambda: bool(exposed))
    assert exposed == [80.0]


def test_the_supervisor_does_not_write_an_exposure_that_is_being_written(bench: Bench) -> None:
    checked = threading.Event()

    def is_controller() -> bool:
        checked.set()
        return True

    def wait_for_the_supervisor() -> None:
        checked.clear()
        assert checked.wait(10)

    bench.connection.is_controller = is_controller  # type: ignore[method-assign]
    bench.connection.slow_exposure = wait_for_the_supervisor
    bench.camera.start(bench.events)
    bench.camera.set_exposure(CameraExposure((80.0,), 6.0))
    # A check that begins now has passed what the supervisor would write.
    wait_for_the_supervisor()
    wait_for_the_supervisor()
    assert bench.connection.n_exposures == 1


def test_a_sequence_is_set_now_or_when_the_camera_is_back_and_begins_anew(bench: Bench) -> None:
    sequence = ((80.0, 0.0), (20.0, 6.0))
    bench.camera.set_exposure(CameraExposure((80.0, 20.0), 0.0, sequence=sequence))
    bench.camera.rewind()
    assert (bench.connection.sequence, bench.connection.rewound) == (sequence, 1)
    bench.camera.start(bench.events)
    bench.connection.error = DeviceError("camera c0: does not answer.", code="camera-lost")
    bench.camera.rewind()
    assert bench.next(CameraLost).error is bench.connection.made[0].error
    bench.next(CameraBack)
    assert bench.connection.sequence == sequence


class AtPort(Connection):
    """An open camera at a port of 1 Gbit/s."""

    def __init__(self, config: CameraConfig, port: str) -> None:
        self.config, self.identity, self.share = config, Identity(config.serial or "", "", port), PortShare()
        self.is_gige, self.packet_bytes, self._speed_mbit_s, self._limit_mbit_s = True, 9000, 1000.0, None


def test_absent_cameras_are_expected_where_cameras_are_missing(tmp_path: Path) -> None:
    """All twelve at one port would need 140 ms for a row."""
    size: dict[str, object] = {"width": 1392, "height": 1040, "link_mbit_s": 1000.0, "address": None}
    configs = [camera_config(name=f"c{n}", serial=f"S{n}", **size) for n in range(12)]
    station = station_config(tmp_path, configs, 0.1)
    pauses = []
    for absent in (range(12, 12), range(6, 11)):
        members: list[AtPort | Unopened] = [
            Unopened(config, DeviceError("")) if n in absent else AtPort(config, "eth1" if n < 6 else "eth2")
            for n, config in enumerate(configs)
        ]
        camera_module._share_links(station, members)
        pauses.append((members[0].share.delay_ns, members[11].share.delay_ns))
    assert pauses[0] == pauses[1]
