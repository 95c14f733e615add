"""`vaoi rig run` and `vaoi rig up` with a scripted station."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from tests.rig.known_boards import CAMERAS, PERIOD_NS, ROWS, known_board, passage_of, run_json
from vaoi_station.config import read_config
from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError, NotFoundError
from vaoi_station.rig import line as feeder_module
from vaoi_station.rig import run as run_module
from vaoi_station.rig import run as status_watch
from vaoi_station.rig import run as up
from vaoi_station.rig.chip import Pulse
from vaoi_station.rig.faults import Fault, parse_fault
from vaoi_station.rig.line import BoardPassage
from vaoi_station.rig.network import NAMESPACE_VARIABLE
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import RigReport
from vaoi_station.rig.run import Plan, StatusWatch, run_rig, run_until_interrupted
from vaoi_station.rig.score import RingCheck
from vaoi_station.simulation import Scenario

TIMEOUT_S = 20.0


class Station:
    """A station whose state the test sets; None: it does not answer."""

    def __init__(self) -> None:
        self.state: str | None = "starting"
        self.connected = [True, True]
        self.polls = threading.Semaphore(0)

    def get(self, path: str) -> dict[str, Any]:
        assert path == "/station"
        self.polls.release()
        if self.state is None:
            raise DeviceError("the station does not answer.")
        return {"state": self.state, "cameras": [{"connected": c} for c in self.connected]}

    def poll_twice(self) -> None:
        """Wait until a poll that began after this call has ended."""
        while self.polls.acquire(blocking=False):
            pass
        for _ in range(2):
            assert self.polls.acquire(timeout=TIMEOUT_S)


@pytest.fixture
def station(monkeypatch: pytest.MonkeyPatch) -> Station:
    monkeypatch.setattr(status_watch, "INTERVAL_S", 0.005)
    return Station()


@pytest.fixture
def watch(station: Station) -> Iterator[StatusWatch]:
    with StatusWatch(cast("Client", station)) as watch:
        yield watch


SHORT_TIMEOUT_S = 0.2
TIMES: dict[str, Any] = {"edges": ((0.0, True), (0.001, False)), "views": {"R1": ((0.0, 1.0, 10.0, 20.0),)}}


class ScriptedStation:
    """A station that finishes one run for every board that passes."""

    def __init__(self) -> None:
        self.change = threading.Lock()
        self.runs: list[dict[str, Any]] = []
        self.commands: list[str] = []
        self.boards_missed = 0
        self.changes: dict[int, dict[str, Any]] = {}
        """Number of a run → what differs from a good one."""
        self.skipped: set[int] = set()
        """Boards of which there is no run."""
        self.stitching_s = 0.0
        """Time from a passage until the ring shows its run as finished; only then the run can be requested."""
        self.hidden: list[tuple[float, dict[str, Any]]] = []

    def record(self, passage: BoardPassage) -> None:
        """Take the run of a passage."""
        if passage.board in self.skipped:
            return
        wall_s = time.time() - time.monotonic() + passage.blocked_ns * 1e-9
        started = datetime.fromtimestamp(wall_s, UTC).isoformat()
        run = run_json(passage.rendered) | {
            "id": f"r{passage.board}",
            "started": started,
            "rows": ROWS,
            "cameras": CAMERAS,
            "counts": {"ok": CAMERAS * ROWS},
            "board_id": self.commands[-1].split()[-1],
        }
        with self.change:
            self.hidden.append((time.monotonic() + self.stitching_s, run | self.changes.get(passage.board, {})))

    def get(self, path: str, **query: Any) -> Any:
        """Answer a request of the rig."""
        if path == "/station":
            with self.change:  # the status watch asks from another thread
                now_s = time.monotonic()
                self.runs += [run for ends_s, run in self.hidden if now_s >= ends_s]
                self.hidden = [(ends_s, run) for ends_s, run in self.hidden if now_s < ends_s]
            bays = [{"run": run["id"], "bay": n, "use": "finished"} for n, run in enumerate(self.runs)]
            bays += [{"run": run["id"], "bay": 9, "use": "stitching"} for _, run in self.hidden]
            cameras = [{"connected": True}] * CAMERAS
            return {
                "state": "armed", "cameras": cameras, "boards_missed": self.boards_missed, "ring": {"bays": bays},
            }  # fmt: skip
        if path == "/runs/next":
            ids = [run["id"] for run in self.runs]
            place = ids.index(query["after"]) + 1 if query["after"] is not None else len(ids)
            return self.runs[place] if place < len(ids) else None
        if path == "/runs/latest":
            if not self.runs:
                raise NotFoundError("there is no run.")
            return self.runs[0]
        known = [*self.runs, *(run for _, run in self.hidden)]
        run = next(run for run in known if path.startswith(f"/runs/{run['id']}"))
        if path.endswith("/matrices"):
            if run["verdict"] == "failed":
                raise NotFoundError("the run has no matrices.")
            return {"components": TIMES["views"]}
        return run

    def post(self, path: str, **fields: Any) -> None:
        self.commands.append(f"{path} {fields['board_type']} {fields.get('board_id', '')}".strip())


class Devices:
    """Devices whose line records every board at once."""

    def __init__(self, station: ScriptedStation, folder: Path, on_row: Callable[[int, int], None]) -> None:
        self.station, self.on_row = station, on_row
        self.addresses, self.terminal = ("127.0.0.2", "127.0.0.3"), folder / "trigger"
        self.cameras = [SimpleNamespace(pid=None)] * CAMERAS
        self.chip = SimpleNamespace(pid=None, send=station.commands.append)
        self.line, self.unexpected_pulses = self, list[Pulse]()
        self.boards = self.permitted = 0

    def __enter__(self) -> Devices:
        return self

    def __exit__(self, *_: object) -> None: ...

    def wait_permitted(self, timeout_s: float) -> bool:
        self.permitted += 1
        return True

    def start_passage(self, rendered: RenderedBoard) -> BoardPassage:
        passage = passage_of(rendered)
        passage.board, self.boards = self.boards, self.boards + 1
        passage.blocked_ns = time.monotonic_ns() + self.boards * 10**9
        for row, fired in enumerate(passage.fired):
            self.on_row(passage.board, row)
            fired.pulse = Pulse(row, passage.blocked_ns + row * PERIOD_NS, (0,), 250.0)
        self.station.record(passage)
        return passage


class Rig:
    """Runs `run_rig` with everything scripted."""

    def __init__(self, scenario: Scenario, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.scenario, self.station, self.lines = scenario, ScriptedStation(), list[str]()
        self.caches: list[Path] = []
        self.unexpected = 0
        station = self.station

        @contextmanager
        def service(_: Path) -> Iterator[Any]:
            yield SimpleNamespace(address="http://station", pid=1)

        def devices(_: Scenario, where: Path, __: Any, on_row: Callable[[int, int], None]) -> Devices:
            made = Devices(station, where, on_row)
            made.unexpected_pulses += [Pulse(0, 0, (), 0.0)] * self.unexpected
            return made

        def prepare(_: Any, __: Any, boards: int, ___: int, cache: Path, ____: Any) -> tuple[RenderedBoard, ...]:
            self.caches.append(cache)
            board = known_board(folder / "board", pulses_s=(0.001,) * ROWS, **TIMES)
            return (Typed(board.directory),) * boards

        def check(ring: Any, bay: int, passage: BoardPassage) -> RingCheck:
            return RingCheck(frozenset((c, r) for c in range(CAMERAS) for r in range(ROWS)), {})

        stand_ins: dict[str, Any] = {
            "Client": lambda _: station, "Service": service, "Devices": devices, "prepare_boards": prepare,
            "build_site": lambda *_, **__: folder / "station.toml", "wait_until_idle": lambda _: None,
            "attach": lambda _: contextmanager(lambda: iter([None]))(), "check_bay": check,
            "min_interval_s": lambda *_: 0.0, "NEXT_RUN_TIMEOUT_S": SHORT_TIMEOUT_S, "READY_TIMEOUT_S": 20.0,
        }  # fmt: skip
        for name, stand_in in stand_ins.items():
            monkeypatch.setattr(run_module, name, stand_in)
        monkeypatch.setattr(feeder_module, "FEED_MARGIN_S", 0.0)
        monkeypatch.setattr("vaoi_station.rig.run.INTERVAL_S", 0.005)

    def run(self, boards: int = 2, faults: tuple[str, ...] = (), cache: Path | None = None) -> RigReport:
        plan = Plan(self.scenario, "small", boards, tuple(map(parse_fault, faults)), faults, cache)
        return run_rig(plan, self.lines.append)


class Typed(RenderedBoard):
    """A known board with the name of a board type."""

    @property
    def board_type(self) -> Any:
        return SimpleNamespace(name="small")


@pytest.fixture
def rig(small: Scenario, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    return Rig(small, tmp_path, monkeypatch)


def test_every_board_is_matched_with_its_run(rig: Rig) -> None:
    report = rig.run(boards=3)
    assert (report.ok, report.failings) == (True, ())
    assert [board.run for board in report.boards] == ["r0", "r1", "r2"]
    assert all((board.status, board.ok, board.wrong) == ("ok", board.rows_due * CAMERAS, ()) for board in report.boards)
    assert rig.station.commands == ["/station/arm small", *(f"/station/arm small board-{n}" for n in range(3))]
    assert [line for line in rig.lines if line.startswith("run")] == [
        f"run {n}: ok, 12 of 12 frames." for n in (1, 2, 3)
    ]


def test_a_board_without_a_run_is_reported_after_the_timeout(rig: Rig) -> None:
    rig.station.skipped = {1}
    report = rig.run(boards=2)
    assert not report.ok
    assert report.failings == ("board 1 has no run",)
    assert report.boards[1].run is None


def test_a_fault_that_never_happens_fails_the_run(rig: Rig) -> None:
    report = rig.run(boards=1, faults=("kill:board=0,row=99",))
    assert report.failings == ("kill did not happen: board 0 had no row 99",)
    assert report.faults == ("kill:board=0,row=99",)


def test_the_station_recovers_from_a_reset_within_the_limit(rig: Rig) -> None:
    report = rig.run(boards=1, faults=("reset:board=0,row=3",))
    assert rig.station.commands[-1] == "reset external"
    [recovery] = report.recoveries
    assert recovery.fault == "reset"
    assert recovery.ready_after_s is not None


COMMANDS: list[str] = []
"""What the scripted devices were asked for, in order."""


class ScriptedDevices:
    """Devices whose chip ends at once, and whose line fails after some boards."""

    passes = 3

    def __init__(self, scenario: Scenario, folder: Path, frame_faults: Any, on_row: Callable[[int, int], None]) -> None:
        self.addresses = tuple(f"127.0.0.{n + 2}" for n in range(scenario.array.cameras))
        self.cameras, self.terminal = self.addresses, folder / "trigger"
        self.chip = SimpleNamespace(alive=False, send=COMMANDS.append)
        self.line = self

    def __enter__(self) -> ScriptedDevices:
        return self

    def __exit__(self, *_: object) -> None:
        COMMANDS.append("closed")

    def lay_calibration_board(self) -> None:
        COMMANDS.append("calibration board")

    def start_passage(self, rendered: RenderedBoard) -> Any:
        if COMMANDS.count("board") == self.passes:
            raise DeviceError("the emulated chip has ended.")
        COMMANDS.append("board")
        return SimpleNamespace()


@pytest.fixture
def start(
    small: Scenario, boards: tuple[RenderedBoard, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., list[str]]:
    """Run until the scripted end; the printed lines."""
    COMMANDS.clear()
    short = [SimpleNamespace(**{n: getattr(boards[0], n) for n in ("calibration", "board_type")}, duration_s=0.0)]
    monkeypatch.setattr(up, "Devices", ScriptedDevices)
    monkeypatch.setattr(up, "prepare_boards", lambda *_: short)
    monkeypatch.setattr(up, "min_interval_s", lambda *_: 0.0)
    monkeypatch.setattr("vaoi_station.rig.line.FEED_MARGIN_S", 0.0)

    def run(*faults: Fault, still: bool = False) -> list[str]:
        lines: list[str] = []
        with pytest.raises(DeviceError, match="the emulated chip has ended"):
            run_until_interrupted(small, faults, tmp_path, tmp_path / "rendered", 1, lines.append, still=still)
        return lines

    return run


def test_the_printed_command_starts_a_station_that_can_be_read(
    start: Callable[..., list[str]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(NAMESPACE_VARIABLE, "")
    lines = start(still=True)
    assert f"Start the station: vaoi serve --config {tmp_path / 'station.toml'}" in lines
    assert f"2 cameras at 127.0.0.2 …, the controller at {tmp_path / 'trigger'}." in lines
    assert read_config(tmp_path / "station.toml").name == "rig"
