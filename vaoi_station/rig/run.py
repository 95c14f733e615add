"""`vaoi rig run` and `vaoi rig up`: run a station on the devices of a rig."""

from __future__ import annotations

import contextlib
import math
import os
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NoReturn

from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.waiting import wait_until_idle
from vaoi_station.errors import DeviceError, GoneError, NotFoundError, VaoiError
from vaoi_station.rig.devices import Devices, FaultInjector, build_site, frame_faults_of, prepare_boards
from vaoi_station.rig.faults import Fault, followers, with_belt_faults
from vaoi_station.rig.line import BoardFeeder, lighting_of, min_interval_s
from vaoi_station.rig.network import entry_command
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import BoardScore, Recovery, RigReport, failings
from vaoi_station.rig.score import (
    BoardEvidence,
    RingCheck,
    attach,
    bays_to_check,
    check_bay,
    run_of,
    score,
)
from vaoi_station.simulation import Scenario, Twin

INTERVAL_S = 0.25
_READY = ("armed", "filming")


class StatusWatch:
    """Watch of the station's status, as a context manager. A thread requests the status and keeps the replies."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._closing = threading.Event()
        self._change = threading.Condition()
        self._states: list[tuple[int, bool]] = []
        """(time, ready) of each reply: ns of CLOCK_MONOTONIC, and whether the station was ready with all cameras."""
        self._requested_ns = 0
        self.last: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._poll, name="status watch")

    def __enter__(self) -> StatusWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()

    def wait(self, condition: Callable[[dict[str, Any]], bool], timeout_s: float) -> bool:
        """Wait until a status requested after this call meets a condition. Return False after the timeout."""
        now_ns = time.monotonic_ns()
        with self._change:
            # Older replies do not count, because they may describe the state before the fault whose end is awaited.
            return self._change.wait_for(lambda: self._requested_ns >= now_ns and condition(self.last), timeout_s)

    def wait_ready(self, timeout_s: float) -> bool:
        """Wait until the station is armed and all its cameras are connected. Return False after the timeout."""
        return self.wait(lambda station: station["state"] == "armed" and all_connected(station), timeout_s)

    def ready_since(self, after_ns: int) -> int | None:
        """Return the time since which the station has been ready without a break; None if it is not ready now."""
        with self._change:
            states = [(when, ready) for when, ready in self._states if when >= after_ns]
        if not states or not states[-1][1]:
            return None
        first = len(states) - 1
        while first and states[first - 1][1]:
            first -= 1
        return states[first][0]

    def _poll(self) -> None:
        while not self._closing.wait(INTERVAL_S):
            requested_ns = time.monotonic_ns()
            try:
                station = self._client.get("/station")
            # A stopped or ending service does not reply. A missing reply gives no state.
            except DeviceError:  # the service is stopped or ending
                continue
            ready = station["state"] in _READY and all_connected(station)
            with self._change:
                self._requested_ns = requested_ns
                self._states.append((time.monotonic_ns(), ready))
                self.last = station
                self._change.notify_all()


def all_connected(station: dict[str, Any]) -> bool:
    """Whether all cameras are connected; `station` is the JSON of `GET station`."""
    return all(camera["connected"] for camera in station["cameras"])


POLL_S = 0.5
NEXT_RUN_TIMEOUT_S = 30.0
"""Time to wait for the next run, s, after the last board has passed, if no run is being filmed or stitched."""
CONCLUDE_TIMEOUT_S = 300.0
"""Time to wait for the next run, s, after the last board has passed, if a run is being stitched.

After an installation the workers compile first, which takes minutes on a busy machine."""
READY_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Plan:
    """The settings of one rig run: scenario, number of boards, faults and workers."""

    scenario: Scenario
    name: str
    boards: int
    faults: tuple[Fault, ...] = ()
    fault_texts: tuple[str, ...] = ()
    cache: Path | None = None
    """Folder in which rendered boards are kept; None: a temporary folder."""
    different: int = 3
    workers: int = 2
    descriptions: tuple[Path, ...] = ()
    """GenICam descriptions that the cameras serve in turn; none: the rig's own."""


@dataclass
class _Record:
    """The data that a rig run collects from the station for the score. The keys of the dictionaries are run ids."""

    began_ns: int = field(default_factory=time.monotonic_ns)
    runs: list[dict[str, Any]] = field(default_factory=list)
    matrices: dict[str, dict[str, Any]] = field(default_factory=dict)
    ring_checks: dict[str, RingCheck | None] = field(default_factory=dict)
    missed: int = 0
    board_ids: list[str | None] = field(default_factory=list)
    """For each board the id with which the station was armed for it; None: that was not possible."""


class _BoardIds:
    """Arms the station for every board with a separate id, like a line that reads a code on each board."""

    def __init__(self, client: Client, watch: StatusWatch, board_type: str) -> None:
        self._client, self._watch, self.board_type = client, watch, board_type
        self.armed: list[str | None] = []

    def arm_next(self, timeout_s: float) -> bool:
        """Wait until the station is ready, and arm it with the id of the next board. Return False after the timeout."""
        ready, board_id = self._watch.wait_ready(timeout_s), f"board-{len(self.armed)}"
        try:
            self._client.post("/station/arm", board_type=self.board_type, board_id=board_id, job_id="rig")
        except VaoiError:  # a fault may prevent another arming; the board then passes without an id
            self.armed.append(None)
        else:
            self.armed.append(board_id)
        return ready


def run_rig(plan: Plan, progress: Callable[[str], None]) -> RigReport:
    """Perform a rig run, and return the report: how each board was recorded and stitched, and what failed."""
    scenario = with_belt_faults(plan.scenario, plan.faults)
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="vaoi-rig-") as made:
        folder = Path(made)
        rendered = prepare_boards(
            scenario, plan.faults, plan.boards, plan.different, plan.cache or folder / "rendered", progress
        )
        injector = FaultInjector(plan.faults)
        progress(f"Starting {scenario.array.cameras} cameras and the controller.")
        frame_faults = frame_faults_of(plan.faults)
        with Devices(scenario, folder, frame_faults, injector.on_row, plan.descriptions) as devices:
            site: dict[str, Any] = {"name": f"rig-{os.getpid()}", "workers": plan.workers, "interlock": True}
            config = build_site(
                scenario, rendered[0], folder, addresses=devices.addresses, port=devices.terminal, **site
            )
            progress("Starting the service.")
            with Service(config) as service, injector:
                # Read before the boards pass: a camera that had to wait for a disk would look like a slow network.
                for board in set(rendered):
                    board.load_into_cache()
                record, passages, recoveries = _run_boards(plan, service, devices, rendered, injector, progress)
        unexpected_pulses = len(devices.line.unexpected_pulses)
    boards = _score_boards(scenario, passages, record, injector)
    failed = [*injector.failed, *_borrowed_ids(boards, record.runs)]
    return _report(plan, boards, record, recoveries, unexpected_pulses, failed, time.monotonic() - began_s)


def _borrowed_ids(boards: Sequence[BoardScore], runs: Sequence[dict[str, Any]]) -> list[str]:
    fed = {board.run for board in boards}
    others = [run for run in runs if run["id"] not in fed and run.get("board_id") is not None]
    return [f"run {run['id']} of a board without an id has the board id {run['board_id']!r}" for run in others]


def _run_boards(
    plan: Plan,
    service: Service,
    devices: Devices,
    rendered: Sequence[RenderedBoard],
    injector: FaultInjector,
    progress: Callable[[str], None],
) -> tuple[_Record, list[Any], tuple[Recovery, ...]]:
    """Arm the station, let all boards pass, and return the collected data, the passages and the recoveries."""
    client, record = Client(service.address), _Record()
    wait_until_idle(client)
    with StatusWatch(Client(service.address)) as watch:
        injector.attach(devices, lambda: _processes(service, watch.last))
        ids = _BoardIds(client, watch, rendered[0].board_type.name)
        client.post("/station/arm", board_type=ids.board_type, job_id="rig")
        watch.wait_ready(READY_TIMEOUT_S)
        interval_s = min_interval_s(plan.scenario, rendered)
        with BoardFeeder(devices.line, rendered, interval_s, ids.arm_next, devices.line.wait_permitted) as feeder:
            _collect_runs(plan, client, feeder, record, progress)
        injector.finish()
        recoveries = _recoveries(injector, watch, record.began_ns)
    record.missed, record.board_ids = client.get("/station")["boards_missed"], ids.armed
    for run in record.runs:
        # A run that failed early has no result.
        record.matrices[run["id"]] = _found(client, f"/runs/{run['id']}/matrices") or {}
    return record, feeder.passages, recoveries


def _collect_runs(
    plan: Plan, client: Client, feeder: BoardFeeder, record: _Record, progress: Callable[[str], None]
) -> None:
    """Collect ended runs into `record`, until there is one run for each board or no more runs can be expected."""
    after, finished_s, busy_s, extra = None, math.inf, 0.0, followers(plan.faults)
    # A board that follows another one too closely has a run of its own, or is missed.
    while len(record.runs) < plan.boards + max(extra - record.missed, 0):
        # The time limits start when all boards have passed. Before that, a run may take any time.
        if feeder.finished.is_set() and math.isinf(finished_s):
            finished_s = time.monotonic()
        # The ring is checked before the next run is requested: a run that ends between the two must not be overlooked.
        if _check_ring(client, feeder, record):
            busy_s = time.monotonic()
        run = client.get("/runs/next", after=after, timeout=POLL_S) or (
            _found(client, "/runs/latest") if after is None else None
        )
        if run is not None:
            after = run["id"]
            record.runs.append(run)
            counts = run["counts"]
            frames = run["rows"] * run["cameras"]
            progress(f"run {len(record.runs)}: {run['verdict']}, {counts['ok']} of {frames} frames.")
            continue
        now_s = time.monotonic()
        if now_s > min(finished_s + CONCLUDE_TIMEOUT_S, max(finished_s, busy_s) + NEXT_RUN_TIMEOUT_S):
            break
    # The last run may have ended after the last check of the ring.
    _check_ring(client, feeder, record)


def _check_ring(client: Client, feeder: BoardFeeder, record: _Record) -> bool:
    """Compare the pixels of every run whose frames are all in the ring, before its bay is given to another board."""
    station = client.get("/station")
    record.missed = station["boards_missed"]
    for run, bay in bays_to_check(station).items():
        if run in record.ring_checks:
            continue
        started_s = {run: _to_monotonic_s(client.get(f"/runs/{run}")["started"])}
        passage = next((p for p in list(feeder.passages) if run_of(p, [{"id": run}], started_s)), None)
        if passage is not None:
            with contextlib.suppress(GoneError, NotFoundError), attach(station) as ring:  # the station may have ended
                record.ring_checks[run] = check_bay(ring, bay, passage)
    return any(bay["use"] in ("filming", "stitching") for bay in station["ring"]["bays"])


def _score_boards(
    scenario: Scenario, passages: Sequence[Any], record: _Record, injector: FaultInjector
) -> tuple[BoardScore, ...]:
    """Score each passage by comparing it with the run of the station that recorded it."""
    resolution = [camera.px_per_mm for camera in Twin(scenario).cameras]
    started_s = {run["id"]: _to_monotonic_s(run["started"]) for run in record.runs}
    by_id = {run["id"]: run for run in record.runs}
    scores, lighting = [], lighting_of(scenario)
    for passage in passages:
        run = run_of(passage, record.runs, started_s)
        evidence = BoardEvidence(
            passage,
            by_id.get(run) if run else None,
            record.matrices.get(run, {}) if run else {},
            record.ring_checks.get(run) if run else None,
            resolution,
            record.board_ids[passage.board],
            lighting,
        )
        scores.append(score(evidence, injector.outages))
    return tuple(scores)


def _recoveries(injector: FaultInjector, watch: StatusWatch, began_ns: int) -> tuple[Recovery, ...]:
    """Measure for each recovered device the time until the station was ready, which ends the outage of its fault."""
    result = []
    for recovery in injector.recoveries:
        watch.wait_ready(READY_TIMEOUT_S)
        ready_ns = watch.ready_since(recovery.recovered_ns)
        if ready_ns is not None:
            injector.close_outage(recovery, ready_ns)
        after_s = None if ready_ns is None else round((ready_ns - recovery.recovered_ns) * 1e-9, 2)
        back_s = round((recovery.recovered_ns - began_ns) * 1e-9, 2)
        result.append(Recovery(fault=recovery.fault.kind, back_s=back_s, ready_after_s=after_s))
    return tuple(result)


def _report(
    plan: Plan,
    boards: tuple[BoardScore, ...],
    record: _Record,
    recoveries: tuple[Recovery, ...],
    unexpected_pulses: int,
    failed: Sequence[str],
    took_s: float,
) -> RigReport:
    array = plan.scenario.array
    placed = [b.deviation for b in boards if b.status == "ok" and b.deviation.views]
    views = sum(d.views for d in placed)
    report = RigReport(
        ok=True,
        scenario=plan.name,
        cameras=array.cameras,
        width_px=array.width_px,
        height_px=array.height_px,
        frames_per_s=round(1 / plan.scenario.line.period_s, 3),
        faults=plan.fault_texts,
        boards=boards,
        runs=len(record.runs),
        boards_missed=record.missed,
        stray_pulses=unexpected_pulses,
        rms_px=round(math.sqrt(sum(d.views * d.rms_px**2 for d in placed) / views), 4) if views else 0.0,
        max_px=max((d.max_px for d in placed), default=0.0),
        recoveries=recoveries,
        took_s=round(took_s, 1),
        failings=(),
    )
    found = (*failings(report, plan.faults, plan.boards), *failed)
    return report.model_copy(update={"ok": not found, "failings": found})


def _processes(service: Service, station: dict[str, Any]) -> dict[str, int]:
    children = {p["name"]: p["pid"] for p in station.get("processes", ()) if p["pid"] is not None}
    return {"station": service.pid, **children}


def _found(client: Client, path: str) -> Any:
    try:
        return client.get(path)
    except NotFoundError:
        return None


def _to_monotonic_s(utc: str) -> float:
    """Convert a recent UTC time (ISO 8601) to seconds of CLOCK_MONOTONIC."""
    return datetime.fromisoformat(utc).timestamp() - time.time() + time.monotonic()


def run_until_interrupted(
    scenario: Scenario,
    faults: tuple[Fault, ...],
    folder: Path,
    cache: Path,
    different: int,
    progress: Callable[[str], None],
    *,
    still: bool = False,
    descriptions: Sequence[Path] = (),
) -> NoReturn:
    """Run the devices until Ctrl-C. At the end all processes are stopped, and only the files in `folder` are left."""
    faulty = with_belt_faults(scenario, faults)
    boards = prepare_boards(faulty, faults, different, different, cache, progress)
    injector = FaultInjector(faults)
    with Devices(faulty, folder, frame_faults_of(faults), injector.on_row, descriptions) as devices, injector:
        injector.attach(devices)
        progress("Rendering the calibration board.")
        # The frames of the calibration board are rendered now, so that a station that starts at once need not wait.
        devices.lay_calibration_board()
        config = build_site(
            faulty, boards[0], folder, name="rig", addresses=devices.addresses, port=devices.terminal, workers=2
        )
        progress(f"{len(devices.cameras)} cameras at {devices.addresses[0]} …, the controller at {devices.terminal}.")
        progress(f"Start the station: {' '.join([*entry_command(), 'vaoi', 'serve', '--config', str(config)])}")
        if still:
            progress("No board passes: the calibration board lies under the cameras. Press Ctrl-C to stop.")
            _wait_without_boards(devices)
        progress("Boards pass, whether the station is armed or not. Press Ctrl-C to stop.")
        _feed_forever(devices, boards, min_interval_s(scenario, boards))


def _wait_without_boards(devices: Devices) -> NoReturn:
    while devices.chip.alive:
        threading.Event().wait(1.0)
    raise DeviceError("the emulated chip has ended.")


def _feed_forever(devices: Devices, boards: Sequence[RenderedBoard], interval_s: float) -> NoReturn:
    while True:
        # The line counts boards over all rounds of this loop, so a fault of one row happens only once.
        with BoardFeeder(devices.line, boards, interval_s) as feeder:
            while not feeder.finished.wait(1.0):
                pass
        threading.Event().wait(max(interval_s - math.fsum((boards[-1].duration_s, 1.0)), 0.0))
