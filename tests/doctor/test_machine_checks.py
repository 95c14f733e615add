"""Interpreter, clocks, kernel parameters, and a station that runs."""

from __future__ import annotations

import http.server
import os
import socket
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from tests.doctor.conftest import assert_problem, only, without_privileges
from vaoi_station.acquisition.cameras.aravis import library
from vaoi_station.acquisition.cameras.aravis.network import PacketLimits
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import ApiConfig, CameraConfig, StationConfig
from vaoi_station.doctor.check_context import CheckContext, RunningProcess
from vaoi_station.doctor.checks import camera_library as aravis
from vaoi_station.doctor.checks import cameras, controller, memory, network, software, usb
from vaoi_station.doctor.checks import machine_clocks as timekeeping
from vaoi_station.doctor.checks import running_station as running
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


@pytest.mark.parametrize(
    ("version", "bits", "level"),
    [((3, 10), 64, Level.FAULT), ((3, 11), 64, Level.OK), ((3, 13), 64, Level.OK), ((3, 14), 64, Level.FAULT),
     ((3, 12), 32, Level.FAULT)],
)  # fmt: skip
def test_pythons(version: tuple[int, int], bits: int, level: Level) -> None:
    assert software.judge_python(version, bits, "x", "/usr/bin/python3").level is level


def test_the_range_of_pythons_is_that_of_the_package() -> None:
    project = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    oldest, untried = (".".join(map(str, v)) for v in (software.OLDEST, software.FIRST_UNTRIED))
    assert f'requires-python = ">={oldest},<{untried}"' in project


def test_a_library_that_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)  # Python's own way to say: not there
    assert_problem(only(software.libraries(Machine())), Level.FAULT, "numba cannot be imported")


def test_no_place_for_compiled_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    locked = tmp_path / "locked"
    locked.mkdir(mode=0o500)
    assert software.judge_cache(str(tmp_path), locked, locked).level is Level.OK
    for given in (str(locked / "cache"), None):
        with without_privileges():
            finding = software.judge_cache(given, locked / "package", locked / "home")
        assert_problem(finding, Level.WARNING, "every start compiles")


def test_clocks() -> None:
    assert timekeeping.judge_wall_clock(0, 1500).figures == {"synchronised": True, "max_error_ms": 1.5}
    assert_problem(timekeeping.judge_wall_clock(timekeeping.TIME_ERROR, 16_000_000), Level.WARNING, "nobody keeps")
    assert timekeeping.judge_wall_clock(-1, 0).level is Level.NOT_APPLICABLE
    assert timekeeping.judge_monotonic(1e-9, "tsc").level is Level.OK
    assert_problem(timekeeping.judge_monotonic(4e-3, "tsc"), Level.WARNING, "4000 µs")
    assert_problem(timekeeping.judge_monotonic(1e-9, "hpet"), Level.WARNING, "hpet")


def test_the_kernel_is_asked_where_it_keeps_its_clock(tmp_path: Path) -> None:
    directory = tmp_path / "sys/devices/system/clocksource/clocksource0"
    directory.mkdir(parents=True)
    (directory / "current_clocksource").write_text("acpi_pm\n")
    assert_problem(only(timekeeping.monotonic_clock(Machine(tmp_path))), Level.WARNING, "acpi_pm")


# ── the network's memory ──


def real(config: StationConfig) -> StationConfig:
    """With cameras of which only the configuration is real."""
    cameras = [
        CameraConfig.model_validate(
            camera.model_dump() | {"backend": "aravis", "address": f"10.0.0.{k}", "width": 1392, "height": 1040}
        )
        for k, camera in enumerate(config.cameras)
    ]  # fmt: skip
    return config.model_copy(update={"cameras": tuple(cameras)})


@pytest.mark.parametrize(("granted", "level"), [("212992", Level.WARNING), ("33554432", Level.OK), ("", Level.FAULT)])
def test_socket_buffers(config: StationConfig, tmp_path: Path, granted: str, level: Level) -> None:
    kernel = tmp_path / "proc/sys/net/core"
    kernel.mkdir(parents=True)
    (kernel / "rmem_max").write_text(granted + "\n")
    finding = only(network.socket_buffers(CheckContext(real(config), Machine(tmp_path), None)))
    assert finding.level is level
    if level is Level.WARNING:
        assert finding.figures == {"rmem_max_bytes": 212992, "needed_bytes": 10 * 1392 * 1040}
        assert "net.core.rmem_max=16777216" in finding.action


# ── cameras' library and USB ──


def by_serial(config: StationConfig) -> StationConfig:
    cameras = [
        camera.model_copy(update={"backend": "aravis", "serial": f"S{k}"}) for k, camera in enumerate(config.cameras)
    ]
    return config.model_copy(update={"cameras": tuple(cameras)})


def test_without_pygobject(config: StationConfig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    library.aravis.cache_clear()
    try:
        finding = only(aravis.aravis(CheckContext(real(config), Machine(), None)))
    finally:
        library.aravis.cache_clear()
    assert_problem(finding, Level.FAULT, "cannot be used from Python")
    assert "apt install" in finding.action


@pytest.mark.parametrize(
    ("version", "perhaps_usb", "level"),
    [((0, 8, 26), 0, Level.OK), ((0, 8, 26), 1, Level.WARNING), ((0, 8, 30), 1, Level.OK), ((0, 9, 1), 2, Level.OK)],
)
def test_versions_of_aravis(version: tuple[int, int, int], perhaps_usb: int, level: Level) -> None:
    finding = aravis.judge_version(version, "3.42.2", perhaps_usb)
    assert finding.level is level
    if level is Level.WARNING:
        assert_problem(finding, level, "unreliable with USB3")


@pytest.mark.parametrize(
    ("granted", "level"),
    [("15", Level.FAULT), ("16", Level.OK), ("0", Level.OK), (None, Level.NOT_APPLICABLE)],
)
def test_usb_memory(config: StationConfig, tmp_path: Path, granted: str | None, level: Level) -> None:
    """Two cameras, 8 MB each; 0 stands for no limit."""
    if granted is not None:
        parameter = tmp_path / usb.PARAMETER
        parameter.parent.mkdir(parents=True)
        parameter.write_text(granted + "\n")
    finding = only(usb.memory(CheckContext(by_serial(config), Machine(tmp_path), None)))
    assert finding.level is level
    if level is Level.FAULT:
        assert_problem(finding, level, "usbfs_memory_mb is 15, 2 cameras on USB need 16")


def test_cameras_with_addresses_need_no_usb(config: StationConfig) -> None:
    assert only(usb.memory(CheckContext(real(config), Machine(), None))).level is Level.NOT_APPLICABLE


# ── a station that runs ──


@pytest.fixture
def owned(config: StationConfig) -> Any:
    with Ring.create(ring_path(config), RingLayout.of(config)):
        yield config


class Answering:
    """A web server that answers everything alike."""

    def __init__(self, status: int, body: bytes) -> None:
        class Handler(http.server.BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self.send_response(status)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: Any) -> None:
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.port: int = self.server.server_address[1]

    def __enter__(self) -> Answering:
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.server.shutdown()
        self.server.server_close()


def at_port(config: StationConfig, port: int) -> StationConfig:
    return config.model_copy(update={"api": ApiConfig(port=port)})


def test_an_owner_that_does_not_answer(owned: StationConfig) -> None:
    found = running.find(owned)
    assert found is not None
    held = CheckContext(owned, Machine(), found)
    assert_problem(only(running.station(held)), Level.WARNING, f"process {os.getpid()} uses", "ConnectionRefused")
    assert_problem(only(cameras.cameras(held)), Level.WARNING, "left alone")
    assert_problem(only(controller.controller(held)), Level.WARNING, "left alone")


def test_a_station_of_another_user_is_no_stranger_at_the_port(config: StationConfig, tmp_path: Path) -> None:
    """Its ring may not be read, but it answers."""
    snapshot = b'{"state": "armed", "cameras": [], "controller": "serial: armed"}'
    path = ring_path(config)
    path.write_bytes(b"")
    path.chmod(0)
    for directory in [path.parent, *path.parent.parents][:-2]:
        directory.chmod(directory.stat().st_mode | 0o011)
    with Answering(200, snapshot) as station, without_privileges():
        found = running.find(at_port(config, station.port))
        held = CheckContext(at_port(config, station.port), Machine(), found)
        finding = only(running.station(held))
        lock = only(memory.lock_limit(held))
    assert (finding.level, finding.message) == (
        Level.OK,
        "runs as a process of another user, state 'armed'; it is asked and left alone",
    )
    assert lock.level is Level.NOT_APPLICABLE


@pytest.mark.parametrize(
    ("status", "body"), [(200, b"hello"), (404, b'{"state": "idle"}'), (200, b"[]"), (200, b'{"status": "ok"}')]
)
def test_an_answer_that_is_no_stations(owned: StationConfig, status: int, body: bytes) -> None:
    with Answering(status, body) as stranger:
        found = running.find(at_port(owned, stranger.port))
    assert found is not None
    assert found.no_reply_reason.startswith(("ValueError", "JSONDecodeError"))


def test_a_port_that_another_program_has(config: StationConfig) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert_problem(
            only(running.station(CheckContext(at_port(config, port), Machine(), None))), Level.FAULT, f":{port}"
        )
    assert only(running.station(CheckContext(at_port(config, port), Machine(), None))).level is Level.OK


def test_what_a_station_complains_of_is_passed_on(config: StationConfig) -> None:
    reason = {"code": "camera-absent", "message": "camera left: there is no camera.", "action": "Check its cable."}
    snapshot = {
        "state": "faulted",
        "reasons": [reason],
        "warnings": [{"code": "calibration-drift", "message": "camera right was knocked.", "action": "Calibrate."}],
        "cameras": [
            {"name": "left", "connected": False, "message": "not open yet"},
            {"name": "right", "connected": True, "message": "", "delivered": 7, "incomplete": 1},
        ],
        "controller": "armed",
    }
    held = CheckContext(config, Machine(), RunningProcess(4711, snapshot))
    state, fault, warning = running.station(held)
    assert state.level is Level.OK
    assert_problem(fault, Level.FAULT, "there is no camera")
    assert_problem(warning, Level.WARNING, "was knocked")
    left, right = cameras.cameras(held)
    assert_problem(left, Level.FAULT, "is not connected: not open yet")
    assert (right.level, right.figures["delivered"]) == (Level.OK, 7)
    assert only(controller.controller(held)).message == "armed"


def test_packets_that_a_camera_does_not_send() -> None:
    """The interface takes them; another MTU would not help."""
    offered = cameras.Offered(
        vendor="Maker", model="M", serial="1", triggers=("FrameStart",), sources=("Line0",), formats=("Mono8",),
        exposure_us=(10.0, 1e6), sensor=(2048, 2048), trigger_mode="On", port="lo", address="127.0.0.1",
        packets=PacketLimits(smallest=200, largest=16000, step=4),
    )  # fmt: skip
    wish = {"name": "a", "backend": "aravis", "address": "127.0.0.1", "exposure_us": 100.0, "packet_bytes": 40000}
    camera = CameraConfig.model_validate({**wish, "width": 64, "height": 64})
    found = cameras.judge_port("lo", [(camera, offered)], 0.1)
    assert_problem(found, Level.WARNING, "a is to have 40000")
    assert found.action.startswith("Set packet_bytes to 16000")
