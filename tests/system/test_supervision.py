"""Every thread of the station is killed and made to hang in turn; every child process is made to hang."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.conftest import until_state
from tests.system.test_faults import arm_until_filming, pid_of, result_of
from tests.system.test_service import as_toml
from tests.test_supervised_thread import kill
from vaoi_station import station as station_module
from vaoi_station.config import StationConfig
from vaoi_station.model import Status
from vaoi_station.runs.workers.fork_server_link import ForkServerLink
from vaoi_station.station import Station
from vaoi_station.supervised_thread import SupervisedThread

TIMEOUT_S = 180.0
THREADS = (
    "store", "coordinator", "bays", "workers", "acquisition-link", "housekeeping", "recordings", "heights", "parts",
    "mosaics", "identity",
)  # fmt: skip


class Broken:
    """A running station, and the faults that it has acted on."""

    def __init__(self, config: StationConfig) -> None:
        self.acted, self.release = threading.Event(), threading.Event()
        self.station = Station(config, on_fault=self.acted.set)
        self.station.start()
        self.coordinator = self.station.coordinator
        assert self.station._supervisor is not None
        self.threads = {thread.name: thread for thread in self.station._supervisor._watched}

    def hang(self, thread: SupervisedThread) -> None:
        """Make a thread wait for the end of the test in its next pass."""
        record = thread.beat

        def stand() -> None:
            record()
            # Not before: a thread that last beat more than a second ago would be noticed at once, and beat again here.
            thread._limit_s = 1.0
            self.release.wait()

        thread.beat = stand  # type: ignore[method-assign]

    def close(self) -> None:
        self.release.set()
        self.station.stop()


@pytest.fixture
def no_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    """Start no fork server and so no worker: imports and warm-up cost more than all the threads of a station."""
    monkeypatch.setattr(ForkServerLink, "_start", lambda link: link._backoff.record_failure())


@pytest.fixture
def broken(
    replay_config: Callable[..., StationConfig], no_workers: None, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Broken]:
    # Without one of its threads a station cannot stop in order.
    monkeypatch.setattr(station_module, "GRACE_S", 0.1)
    made = Broken(replay_config().model_copy(update={"workers": 1}))
    yield made
    made.close()


def test_every_thread_is_supervised(broken: Broken) -> None:
    assert set(broken.threads) == set(THREADS)
    serving = {t.name for t in threading.enumerate() if isinstance(t, SupervisedThread)}
    assert serving == {*THREADS, "supervisor"}
    assert broken.coordinator.faults() == ()


@pytest.mark.parametrize("name", THREADS)
def test_a_thread_that_ends_is_noticed(broken: Broken, name: str) -> None:
    kill(broken.threads[name])
    # The threads of the store and of recordings wait for work without a limit: they end when some comes.
    threading.Thread(target=_publish, args=(broken,), daemon=True).start()
    assert broken.acted.wait(TIMEOUT_S)
    [reason] = broken.coordinator.faults()
    assert reason.code == "thread-lost"
    assert reason.message == f"Thread {name!r} has ended (SystemExit)."


@pytest.mark.parametrize("name", THREADS)
def test_a_thread_that_hangs_is_noticed(broken: Broken, name: str) -> None:
    broken.hang(broken.threads[name])
    threading.Thread(target=_publish, args=(broken,), daemon=True).start()
    assert broken.acted.wait(TIMEOUT_S)
    [reason] = broken.coordinator.faults()
    assert f"Thread {name!r} hangs for" in reason.message


def _publish(broken: Broken) -> None:
    """Give the threads work that wait for it without a limit."""
    broken.coordinator.kept.recordings.request("no such run")
    broken.coordinator._parts.events.add("test", "something to write")


SERVE = """
import sys, threading
from pathlib import Path
from vaoi_station import station
from vaoi_station.config import read_config
from vaoi_station.supervised_thread import SupervisedThread

def lose():
    {lose}

notify = station.notify
def ready(state):
    notify(state)
    if state == "READY=1":
        [thread] = [t for t in threading.enumerate() if t.name == {name!r}]
        thread._limit_s = 1.0
        thread.beat = lose
station.notify = ready
station.serve(read_config(Path(sys.argv[1])), 0)
"""
LOSE = {"ends": "raise SystemExit", "hangs": "threading.Event().wait()"}


@pytest.mark.parametrize(("name", "how"), [("api", "ends"), ("workers", "hangs")])
def test_a_service_that_lost_a_thread_ends_so_that_it_is_started_again(
    replay_config: Callable[..., StationConfig], tmp_path: Path, name: str, how: str
) -> None:
    config = tmp_path / "station.toml"
    config.write_text(as_toml(replay_config().model_copy(update={"workers": 1})))
    command = [sys.executable, "-c", SERVE.format(lose=LOSE[how], name=name), str(config)]
    folder = Path(__file__).parents[2]
    # A file, not a pipe: the workers have it open until they have ended as well.
    with (tmp_path / "log").open("w") as log:
        done = subprocess.run(command, check=False, cwd=folder, stdout=log, stderr=log, timeout=TIMEOUT_S)
    assert done.returncode not in (0, 2, 3), "systemd restarts what failed"
    said = "hangs for" if how == "hangs" else "SystemExit"
    assert said in (tmp_path / "log").read_text()


def fed(listener: socket.socket, timeout_s: float) -> bool:
    """Return whether the watchdog is fed within a time."""
    until_s = time.monotonic() + timeout_s
    while (left_s := until_s - time.monotonic()) > 0:
        listener.settimeout(left_s)
        with contextlib.suppress(TimeoutError):
            if listener.recv(1000) == b"WATCHDOG=1":
                return True
    return False


@pytest.mark.usefixtures("no_workers")
def test_a_supervisor_that_hangs_feeds_no_watchdog(
    replay_config: Callable[..., StationConfig], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listener:
        listener.bind(str(tmp_path / "notify"))
        monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
        broken = Broken(replay_config().model_copy(update={"workers": 1}))
        try:
            assert fed(listener, TIMEOUT_S)
            supervisor = broken.station._supervisor
            assert supervisor is not None
            hung = threading.Event()

            def stand() -> None:
                hung.set()
                broken.release.wait()

            supervisor._alive = stand
            assert hung.wait(TIMEOUT_S)
            while fed(listener, 0.1):  # what was sent before
                continue
            assert not fed(listener, 1.5)
        finally:
            broken.close()


def test_no_board_is_lost_by_a_worker_that_hangs(replay_config: Callable[..., StationConfig]) -> None:
    with Station(replay_config(pace="original", pause_s=0.3)) as station:
        coordinator = station.coordinator
        until_state(coordinator, "idle")
        began, victim = arm_until_filming(coordinator)
        hung = pid_of(coordinator, "worker 1")
        os.kill(hung, signal.SIGSTOP)
        run = result_of(coordinator, victim, began)
        assert (run.state, run.verdict) == ("ready", Status.OK), run.reasons
        assert run.timings is not None
        assert run.timings.ready_after_last_frame_ms is not None
        assert run.timings.ready_after_last_frame_ms < 15_000, "its jobs did not wait for the 30 s of a hung worker"
        coordinator.disarm()


def test_no_board_is_lost_without_the_fork_server(
    replay_config: Callable[..., StationConfig], monkeypatch: pytest.MonkeyPatch
) -> None:
    with Station(replay_config(pace="original", pause_s=0.3).model_copy(update={"workers": 1})) as station:
        coordinator = station.coordinator
        until_state(coordinator, "idle")
        seen = coordinator.snapshot().last_event
        began, victim = arm_until_filming(coordinator)
        os.kill(pid_of(coordinator, "fork server"), signal.SIGSTOP)
        with monkeypatch.context() as impatient:  # only now: the next one may start slowly
            impatient.setattr("vaoi_station.runs.workers.fork_server_link.REPLY_LIMIT_S", 1.0)
            run = result_of(coordinator, victim, began)
            assert (run.state, run.verdict) == ("ready", Status.OK), run.reasons
            ended = list[str]()
            while not ended:
                records = coordinator.events(seen, TIMEOUT_S)
                ended = [record.message for record in records if record.kind == "process"]
                seen = records[-1].number
        assert "The fork server" in ended[0]
        coordinator.disarm()
