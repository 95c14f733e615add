"""Find the running station, read its state, and check its port."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.doctor.conftest import assert_problem, at_port, only, without_privileges
from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.acquisition.ring.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.doctor.check_context import CheckContext, RunningProcess
from vaoi_station.doctor.checks import cameras, controller, memory, running_station
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


@pytest.fixture
def owned(config: StationConfig) -> Iterator[StationConfig]:
    """The configuration while this process owns its ring."""
    with Ring.create(ring_path(config), RingLayout.of(config)):
        yield config


@contextmanager
def replying(status: int, body: bytes) -> Iterator[int]:
    """Serve the same reply to every request, at the port that is returned."""

    class Handler(ScriptedHandler):
        def do_GET(self) -> None:  # noqa: N802  (the name is that of the base class)
            self.send(status, body)

    with serving(Handler) as address:
        yield int(address.rpartition(":")[2])


def test_no_ring_means_no_running_station(config: StationConfig) -> None:
    assert running_station.find(config) is None


def test_owner_of_the_ring_without_a_reply_is_a_warning(owned: StationConfig) -> None:
    found = running_station.find(owned)
    assert found is not None
    context = CheckContext(owned, Machine(), found)
    station = only(running_station.station(context))
    assert_problem(station, Level.WARNING, f"process {os.getpid()} uses", "ConnectionRefused")
    assert_problem(only(cameras.cameras(context)), Level.WARNING, "were not opened")
    assert_problem(only(controller.controller(context)), Level.WARNING, "was not opened")


def test_station_of_another_user_is_recognised_by_its_reply(config: StationConfig) -> None:
    """Its ring cannot be read, but its REST service replies."""
    snapshot = b'{"state": "armed", "cameras": [], "controller": "serial: armed"}'
    path = ring_path(config)
    path.write_bytes(b"")
    path.chmod(0)
    for directory in [path.parent, *path.parent.parents][:-2]:
        directory.chmod(directory.stat().st_mode | 0o011)
    with replying(200, snapshot) as port, without_privileges():
        found = running_station.find(at_port(config, port))
        context = CheckContext(at_port(config, port), Machine(), found)
        finding = only(running_station.station(context))
        lock = only(memory.lock_limit(context))
    assert (finding.level, finding.message) == (
        Level.OK,
        "runs as a process of another user, state 'armed'; its devices are not opened",
    )
    assert lock.level is Level.NOT_APPLICABLE


@pytest.mark.parametrize(
    ("status", "body"), [(200, b"hello"), (404, b'{"state": "idle"}'), (200, b"[]"), (200, b'{"status": "ok"}')]
)
def test_reply_of_another_program_is_not_taken_for_a_station(owned: StationConfig, status: int, body: bytes) -> None:
    with replying(status, body) as port:
        found = running_station.find(at_port(owned, port))
    assert found is not None
    assert found.no_reply_reason.startswith(("ValueError", "JSONDecodeError"))


def test_port_in_use_by_another_program_is_a_fault(config: StationConfig) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        context = CheckContext(at_port(config, port), Machine(), None)
        assert_problem(only(running_station.station(context)), Level.FAULT, f":{port}")
    assert only(running_station.station(context)).level is Level.OK


def test_reasons_and_warnings_of_the_station_become_findings(config: StationConfig) -> None:
    snapshot = {
        "state": "faulted",
        "reasons": [{"code": "camera-absent", "message": "camera left is absent.", "action": "Check its cable."}],
        "warnings": [{"code": "calibration-drift", "message": "camera right has moved.", "action": "Calibrate."}],
    }
    state, fault, warning = running_station.station(CheckContext(config, Machine(), RunningProcess(4711, snapshot)))
    assert state.level is Level.OK
    assert_problem(fault, Level.FAULT, "camera left is absent")
    assert fault.subject == "camera-absent"
    assert_problem(warning, Level.WARNING, "camera right has moved")


def test_reasons_of_a_station_that_is_not_faulted_are_warnings(config: StationConfig) -> None:
    snapshot = {"state": "idle", "reasons": [{"code": "x", "message": "m", "action": "a"}]}
    _, finding = running_station.station(CheckContext(config, Machine(), RunningProcess(4711, snapshot)))
    assert finding.level is Level.WARNING
