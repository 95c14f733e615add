"""One soak: boards pass back to back, faults come at random, every board is sampled, every run is accounted for."""

from __future__ import annotations

import random
import threading
import time
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import httpx2

from tests.soak.accounts import Accounts, account, list_runs
from tests.soak.faults import FAULTS, Target, draw
from tests.soak.line_files import KEPT_RUNS, Pace, write_line_files
from tests.soak.sampling import file_usage, station_usage
from tests.soak.service import Ends, Service, ask, events_of, wait_until
from tests.soak.small_disk import SmallDisk

STEP_S = 0.05
"""Pause between two checks of the count of boards."""
STALLED_S = 400.0
"""Time without any announcement after which the soak ends: the station has stopped for good."""
UNDER_WAY = ("filming", "stitching")
SETTLE_S = 60.0
"""Longest time for the last runs to end and reach the disk."""


@dataclass(frozen=True)
class Plan:
    """What a soak does."""

    boards: int
    pause_s: float = 0.15
    faults: tuple[str, ...] = ()
    every: float = 20.0
    """Mean number of boards between two faults."""
    duration: float = 1.0
    """Factor of the time for which faults last."""
    lost_share: float = 0.0
    """Share of the boards during which a camera is lost."""
    seed: int = 1
    limit_s: float = float("inf")
    """Longest time; fewer boards pass if it is over before."""


@dataclass
class Injected:
    """A fault that was injected, and when the next board was announced after it had ended."""

    name: str
    board: int
    lasted_s: float
    recovered_s: float | None = None
    """Time from its end to the announcement of the next board that began after it."""


@dataclass
class Record:
    """Everything that a soak has measured."""

    samples: list[dict[str, Any]] = field(default_factory=list)
    announced: dict[str, str] = field(default_factory=dict)
    injected: list[Injected] = field(default_factory=list)
    accounts: Accounts | None = None
    ends: Ends | None = None
    exit_code: int | None = None
    played: int | None = None
    """Boards that the replayed line has played, if its process has lived for the whole soak."""
    seconds: float = 0.0


class Soak:
    """The running soak."""

    def __init__(self, folder: Path, plan: Plan) -> None:
        self._plan, self._chance = plan, random.Random(plan.seed)
        self._data, self._shm = folder / "data", folder / "shm"
        config = write_line_files(folder, self._data, Pace(plan.pause_s, plan.lost_share, plan.seed))
        self._disk = SmallDisk(self._data) if "disk full" in plan.faults else None
        self.record = Record()
        self._station: dict[str, Any] = {}
        self._done = threading.Event()
        self._failure: Exception | None = None
        self._service = Service(config, folder / "log.txt", self._disk.prefix if self._disk else ())
        self._follower = threading.Thread(target=self._follow_or_fail, name="follower", daemon=True)

    def run(self) -> Record:
        """Let all boards pass; return what was measured."""
        began_s = time.monotonic()
        try:
            wait_until(self._service, ["idle"])
            self._follower.start()
            # The first request for the next run must wait before the first board comes.
            self._done.wait(0.5)
            with self._service.client() as client:
                client.post("/station/arm", json={"board_type": "tiny"}).raise_for_status()
            self._inject(began_s)
            self.record.seconds = time.monotonic() - began_s
            self._settle()
        finally:
            self._done.set()
            self.record.exit_code = self._service.stop()
            self.record.ends = self._service.ends
            if self._disk:
                self._disk.close()
        return self.record

    def log(self) -> str:
        """Return everything that the station has written."""
        return self._service.log()

    def _follow_or_fail(self) -> None:
        """Follow until the end; keep an error for the thread that injects faults, which would wait for samples."""
        try:
            self._follow()
        except Exception as error:  # noqa: BLE001 - every error ends the soak
            self._failure = error

    def _follow(self) -> None:
        """Receive every announcement once, and sample the station after each."""
        after: dict[str, str] = {}
        with self._service.client() as client:
            while not self._done.is_set():
                run = ask(client, "/runs/next", timeout=10, **after)
                now = time.time()
                if run is None:
                    self._done.wait(STEP_S)
                    continue
                after = {"after": run["id"]}
                self.record.announced[run["id"]] = run.get("verdict") or ""
                if station := ask(client, "/station"):
                    self._station = station
                self.record.samples.append(self._sample(run, now))

    def _sample(self, run: dict[str, Any], now: float) -> dict[str, Any]:
        # nsenter shows the data directory of the station's own mount namespace.
        data = self._disk.directory if self._disk else self._data
        timings = run.get("timings") or {}
        announced_ms, started = None, datetime.fromisoformat(run["started"]).timestamp()
        if timings.get("ready_after_last_frame_ms") is not None:
            announced_ms = (now - started - timings["filming_s"]) * 1e3
        return {
            "t": now,
            "run": run["id"],
            "started": started,
            "verdict": run.get("verdict"),
            "missed": self._station.get("boards_missed", 0),
            "controller": self._station.get("controller", ""),
            "result_ms": timings.get("ready_after_last_frame_ms"),
            "announced_ms": announced_ms,
            "processes": station_usage(self._service.pid, self._station),
            **file_usage(data, self._shm),
        }

    def _boards(self) -> int:
        if self._failure is not None:
            raise RuntimeError(f"boards are not followed any more after {len(self.record.samples)}") from self._failure
        return len(self.record.samples)

    def _inject(self, began_s: float) -> None:
        """Inject faults until enough boards have passed."""
        plan, next_at = self._plan, self._next_fault(0)
        target = Target(self._service, self._disk, lambda: self._station, lambda: next(reversed(self.record.announced)))
        progress, progress_s = 0, time.monotonic()
        while (boards := self._boards()) < plan.boards and time.monotonic() - began_s < plan.limit_s:
            if boards != progress:
                progress, progress_s = boards, time.monotonic()
            if time.monotonic() - progress_s > STALLED_S:
                raise TimeoutError(f"no board for {STALLED_S} s after board {boards}: {self._service.log()[-3000:]}")
            if boards >= next_at:
                name, lasts_s = draw(self._chance, plan.faults)
                lasts_s *= plan.duration
                with FAULTS[name].inject(target, self._chance):
                    self._done.wait(lasts_s)
                self.record.injected.append(self._recover(Injected(name, boards, lasts_s)))
                next_at = self._next_fault(self._boards())
            self._done.wait(STEP_S)

    def _recover(self, fault: Injected) -> Injected:
        """Wait for a board that has begun after the end of a fault, and whose result is announced."""
        ended, ended_s = datetime.now().astimezone(), time.monotonic()
        while time.monotonic() - ended_s < STALLED_S:
            newest = self.record.samples[self._boards() - 1]
            if newest["started"] > ended.timestamp() and newest["result_ms"] is not None:
                fault.recovered_s = newest["t"] - ended.timestamp()
                return fault
            self._done.wait(STEP_S)
        raise TimeoutError(f"no board within {STALLED_S} s after {fault}: {self._service.log()[-3000:]}")

    def _next_fault(self, boards: int) -> float:
        return boards + 5 + self._chance.expovariate(1 / self._plan.every) if self._plan.faults else float("inf")

    def _settle(self) -> None:
        """Disarm, wait until every run has ended and is on disk, and account for all."""
        with self._service.client() as client:
            deadline_s = time.monotonic() + SETTLE_S
            wait_until(self._service, ["armed", "filming", "idle", "blocked", "degraded"])
            client.post("/station/disarm").raise_for_status()
            while time.monotonic() < deadline_s:
                listed = list_runs(client)
                newest = max(listed, default="")
                open_ = [r for r in listed.values() if r["state"] in UNDER_WAY or not r.get("stored", True)]
                if newest in self.record.announced and not open_:
                    break
                self._done.wait(STEP_S)
            station = ask(client, "/station") or {}
            self.record.accounts = account(
                self.record.announced, list_runs(client), events_of(self._service, station["last_event"]), KEPT_RUNS
            )
            # The controller's count begins anew with its process.
            if not any("acquisition" in f.name or "station" in f.name for f in self.record.injected):
                counted = self.record.accounts.announced + self.record.accounts.missed
                self.record.played = self._played(client, counted, deadline_s)

    def _played(self, client: httpx2.Client, least: int, deadline_s: float) -> int:
        """Return how many boards the replayed line has played; a heartbeat brings the number after the last run."""
        while True:
            station = ask(client, "/station") or {"controller": ""}
            played = int("".join(c for c in station["controller"] if c.isdigit()) or 0)
            if played >= least or time.monotonic() > deadline_s:
                return played
            self._done.wait(STEP_S)
