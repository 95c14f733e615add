"""The start of a station: refusals, each without remaining files, and the warm-up of its workers."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest

from tests.hermes.station import free_port
from tests.hermes.test_service import HELLO
from tests.hermes.test_service import Peer as Neighbour
from tests.project.test_formats_doc import EXAMPLES
from tests.runs.peer import Peer
from vaoi_station.acquisition.process.messages import Ready
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import CameraConfig, ReplayConfig, RingConfig, StationConfig
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files import write_calibration
from vaoi_station.hermes.messages import Message
from vaoi_station.line_config import Hermes, Line
from vaoi_station.model import Calibration
from vaoi_station.runs.control import acquisition_link
from vaoi_station.runs.host.service import PASSING
from vaoi_station.runs.states.schemas import WAITING, StationSnapshot
from vaoi_station.runs.workers.fork_server_link import ForkServerLink
from vaoi_station.station import DATABASE, Station


def calibration(cameras: int) -> Calibration:
    matrices = [[[2.0, 0, -60.0 * i], [0, 2.0, 0], [0, 0, 1]] for i in range(cameras)]
    document = {"format": "vaoi-calibration", "version": 1, "unit": "mm", "camera_matrices": matrices}
    return Calibration.model_validate(document)


@pytest.fixture
def config(tmp_path: Path) -> StationConfig:
    (tmp_path / "shm").mkdir()
    write_calibration(tmp_path / "calibration.json", calibration(2))
    cameras = [CameraConfig(name=f"c{i}", backend="replay", width=64, height=48, exposure_us=100.0) for i in range(2)]
    return StationConfig.model_validate(
        {
            "calibration": tmp_path / "calibration.json",
            "board_types": tmp_path / "board-types",
            "data": tmp_path / "data",
            "workers": 1,
            "line": Line(
                conveyor_mm_s=(0.0, 100.0), barrier_mm=0.0, start_delay_s=0.0,
                trigger_period_s=0.1, tail_s=0.0, longest_board_mm=50.0,
            ),
            "cameras": cameras,
            "controller": {"backend": "replay"},
            "replay": ReplayConfig(recordings=(tmp_path / "recording",)),
            "ring": RingConfig(directory=tmp_path / "shm"),
        }
    )  # fmt: skip


def remaining_files(config: StationConfig) -> list[Path]:
    return list(config.ring.directory.iterdir())


def test_calibration_of_another_array_is_refused(config: StationConfig) -> None:
    write_calibration(config.calibration, calibration(3))
    with pytest.raises(InputError, match="camera_matrices has 3 entries, but 2 cameras were filming") as refusal:
        Station(config).start()
    assert "calibration of this array" in refusal.value.action
    assert remaining_files(config) == []
    assert not config.data.exists()


def test_before_the_first_calibration_cameras_are_set_up_and_the_line_is_not_armed(config: StationConfig) -> None:
    config.calibration.unlink()
    with pytest.raises(NotFoundError, match=r"calibration\.json"):
        Station(config).start()
    nominal = {"nominal_px_per_mm": 2.0}
    cameras = tuple(
        camera.model_copy(update={**nominal, "nominal_center_mm": (30.0 * n, 0.0)})
        for n, camera in enumerate(config.cameras)
    )
    (config.board_types).mkdir()
    (config.board_types / "demo.json").write_text(json.dumps({**json.loads(EXAMPLES[3]), "name": "demo"}))
    with Station(config.model_copy(update={"cameras": cameras})) as station:
        assert [camera.name for camera in station.coordinator.snapshot().cameras] == ["c0", "c1"]
        until(station, lambda snapshot: "no-calibration" in [warning.code for warning in snapshot.warnings])
        with pytest.raises(StateError, match="is not calibrated yet") as refused:
            station.coordinator.arm("demo")
    assert refused.value.code == "no-calibration"


def test_a_station_lets_the_next_board_come_by_messages_only_while_its_line_may_take_it(config: StationConfig) -> None:
    above = free_port()
    hermes = Hermes(upstream=f"127.0.0.1:{above}", listen=f"127.0.0.1:{free_port()}")
    with socket.create_server(("127.0.0.1", above)) as server:
        server.settimeout(30)
        with Station(config.model_copy(update={"hermes": hermes})) as station, server.accept()[0] as connection:
            peer = Neighbour(connection)
            peer.next("ServiceDescription")
            peer.send(HELLO, Message.of("CheckAlive", Type=1, Id="1"))
            peer.next("CheckAlive")
            assert station.line is not None
            until(station, lambda _: station.line is not None and bool(station.line.status().held))
            assert {reason.code for reason in station.line.status().held} <= {"line-not-armed", "controller-not-ready"}
            assert station.line.status().neighbours[0].state == "idle"


def test_damaged_database_is_set_aside_and_the_station_starts(config: StationConfig) -> None:
    config.data.mkdir()
    (config.data / DATABASE).write_bytes(b"not a database " * 1000)
    with Station(config) as station:
        until(station, lambda snapshot: "database-damaged" in [warning.code for warning in snapshot.warnings])
    assert [path.read_bytes()[:5] for path in config.data.glob("*.damaged-*")] == [b"not a"]
    assert remaining_files(config) == []


def test_a_start_that_meets_a_full_disk_leaves_nothing_behind_and_has_a_code_that_passes(config: StationConfig) -> None:
    config.data.parent.joinpath("in-the-way").write_text("")
    lost = config.model_copy(update={"data": config.data.parent / "in-the-way" / "data"})
    with pytest.raises(DeviceError, match="cannot be used") as refusal:
        Station(lost).start()
    assert refusal.value.code in PASSING
    assert remaining_files(config) == []


def test_ring_of_another_station_is_not_taken(config: StationConfig) -> None:
    with Ring.create(ring_path(config), RingLayout.of(config)):
        station = Station(config)
        with pytest.raises(StateError, match="exists already"):
            station.start()
        station.stop()
    assert remaining_files(config) == []


def test_missing_recordings_leave_the_station_faulted_with_the_reason(config: StationConfig) -> None:
    with Station(config) as station:
        seen, troubles = 0, list[str]()
        while not troubles or station.coordinator.snapshot().state != "faulted":
            records = station.coordinator.events(seen, COMPILED_S)
            assert records
            seen = records[-1].number
            troubles += [r.message for r in records if r.kind == "trouble" and "recording.json" in r.message]
        assert "there is no such file" in troubles[0]
    assert remaining_files(config) == []


COMPILED_S = 600.0
"""Time limit for the workers to compile on a busy machine."""


def until(started: Station, holds: Callable[[StationSnapshot], bool]) -> StationSnapshot:
    """Wait until a condition holds for the station's snapshot; its events wake the caller."""
    deadline_s, seen = time.monotonic() + COMPILED_S, 0
    while not holds(snapshot := started.coordinator.snapshot()):
        assert time.monotonic() < deadline_s, snapshot
        records = started.coordinator.events(seen, 1.0)
        seen = records[-1].number if records else seen
    return snapshot


@pytest.mark.timeout(2 * COMPILED_S)
def test_no_board_is_accepted_before_the_workers_are_ready_and_requests_are_answered_before(
    config: StationConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However long the workers take, as after an installation: ready means that boards are stitched at once."""
    peer = Peer()
    monkeypatch.setattr(acquisition_link, "HEARTBEAT_LIMIT_S", COMPILED_S)
    with monkeypatch.context() as held:
        held.setattr(ForkServerLink, "_start", lambda link: link._backoff.record_failure())
        with ExitStack() as parts:
            started = parts.enter_context(Station(config, peer.launch))
            parts.callback(peer.close)
            peer.wait_for_start(1)
            peer.report(Ready(2))
            waiting = until(started, lambda snapshot: snapshot.processes[0].doing == WAITING)
            assert waiting.state == "starting"
            [warning] = waiting.warnings
            assert warning.code == "workers-starting"
            assert warning.message.startswith("No board is filmed yet: ")
            held.undo()
            until(started, lambda snapshot: snapshot.state != "starting")
            reported = [event for event in started.coordinator.events() if event.code != "ring-not-locked"]
            assert reported[0].message == "The workers are ready: results come at once."
            assert started.coordinator.snapshot().warnings == ()
