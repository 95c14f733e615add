"""`vaoi rig run`: rig and service are started, boards pass, every one is scored, everything is taken down."""

from __future__ import annotations

import contextlib
import math
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.demo.scratch import scratch_folder
from vaoi_station.demo.service import Service
from vaoi_station.demo.watching import until_idle
from vaoi_station.errors import GoneError, NotFoundError
from vaoi_station.rig.fault_injection import Saboteur, mischief_of
from vaoi_station.rig.line.assembly import Devices, film_boards
from vaoi_station.rig.line.faults import Fault, befallen
from vaoi_station.rig.line.feeder import Conveyor
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.scenarios import least_interval_s
from vaoi_station.rig.scoring.cpu_load import LoadMeter
from vaoi_station.rig.scoring.rig_report import BoardScore, Load, Recovery, RigReport
from vaoi_station.rig.scoring.ring_check import Sighting, attach, filmed_bays, look_at
from vaoi_station.rig.scoring.score import Evidence, run_of, score
from vaoi_station.rig.scoring.verdict import failings
from vaoi_station.rig.site import build_site
from vaoi_station.rig.status_watch import Watch
from vaoi_station.simulation import Scenario, Twin

POLL_S = 0.5
LAST_RUN_S = 30.0
"""For the results of boards that have passed; a run without them is none."""
CONCLUDED_S = 300.0
"""The same for boards that are being stitched: after an installation workers compile, on a busy machine for minutes."""
READY_S = 30.0
"""For a station to be ready again after a fault, before it is told that it is not."""


@dataclass(frozen=True)
class Plan:
    """What is to be done."""

    scenario: Scenario
    name: str
    """Of the scenario, for the report."""
    boards: int
    faults: tuple[Fault, ...] = ()
    fault_words: tuple[str, ...] = ()
    """As they were given."""
    films: Path | None = None
    """Where films are kept; None: nowhere."""
    different: int = 3
    workers: int = 2


@dataclass
class _Story:
    """What happened."""

    began_ns: int = field(default_factory=time.monotonic_ns)
    runs: list[dict[str, Any]] = field(default_factory=list)
    matrices: dict[str, dict[str, Any]] = field(default_factory=dict)
    sightings: dict[str, Sighting] = field(default_factory=dict)
    missed: int = 0
    load: Load | None = None


def run_rig(plan: Plan, tell: Callable[[str], None]) -> RigReport:
    """Let boards pass and say how they came out.

    Raises:
        DeviceError: rig or service do not come up.
    """
    scenario = befallen(plan.scenario, plan.faults)
    began_s = time.monotonic()
    with scratch_folder("rig") as folder:
        films = film_boards(scenario, plan.faults, plan.boards, plan.different, plan.films or folder / "films", tell)
        saboteur = Saboteur(plan.faults)
        tell(f"Starting {scenario.array.cameras} cameras and the controller.")
        with Devices(scenario, folder, mischief_of(plan.faults), saboteur.noticed) as devices:
            port = devices.terminal
            name = f"rig-{os.getpid()}"
            config = build_site(
                scenario, films[0], folder, name=name, addresses=devices.addresses, port=port, workers=plan.workers
            )
            tell("Starting the service.")
            with Service(config) as service, saboteur:
                for film in set(films):
                    film.warm()
                story, passed, recoveries = _play(plan, service, devices, films, saboteur, tell)
        strays = len(devices.stage.strays)
    boards = _scores(scenario, passed, story, saboteur)
    return _report(plan, boards, story, recoveries, strays, saboteur.failed, time.monotonic() - began_s)


def _play(
    plan: Plan,
    service: Service,
    devices: Devices,
    films: Sequence[Film],
    saboteur: Saboteur,
    tell: Callable[[str], None],
) -> tuple[_Story, list[Any], tuple[Recovery, ...]]:
    """The boards' part."""
    client, story = Client(service.address), _Story()
    until_idle(client)
    with Watch(Client(service.address)) as watch:
        saboteur.use(devices)
        saboteur.ask_for_processes(lambda: _processes(service, watch.last))
        client.post("/station/arm", board_type=films[0].board_type.name, job_id="rig")
        watch.wait_ready(READY_S)
        meter = LoadMeter(_everybody(service, watch.last, devices))
        interval_s = least_interval_s(plan.scenario, films)
        with Conveyor(devices.stage, films, interval_s, watch.wait_ready) as conveyor:
            _follow(plan, client, conveyor, story, tell)
        story.load = meter.read(sum(run["counts"]["ok"] for run in story.runs))
        saboteur.over()
        recoveries = _recoveries(saboteur, watch, story.began_ns)
    story.missed = client.get("/station")["boards_missed"]
    for run in story.runs:
        story.matrices[run["id"]] = _matrices(client, run["id"])
    return story, conveyor.passed, recoveries


def _follow(plan: Plan, client: Client, conveyor: Conveyor, story: _Story, tell: Callable[[str], None]) -> None:
    """Every run, until there is one of every board, or no more come."""
    after, over_s, limit_s = None, math.inf, LAST_RUN_S
    while len(story.runs) < plan.boards and time.monotonic() < over_s + limit_s:
        if conveyor.empty.is_set() and math.isinf(over_s):
            over_s = time.monotonic()
        run = client.get("/runs/next", after=after, timeout=POLL_S) or (_latest(client) if after is None else None)
        limit_s = CONCLUDED_S if _look(client, conveyor, story) else LAST_RUN_S
        if run is not None:
            after = run["id"]
            story.runs.append(run)
            counts = run["counts"]
            tell(f"run {len(story.runs)}: {run['verdict']}, {counts['ok']} of {run['rows'] * run['cameras']} frames.")


def _look(client: Client, conveyor: Conveyor, story: _Story) -> bool:
    """At the pixels of every run that has been filmed, before its memory goes to another board.

    Returns:
        Whether a run is still being filmed or stitched.
    """
    station = client.get("/station")
    for run, bay in filmed_bays(station).items():
        if run in story.sightings:
            continue
        started_s = {run: _host_s(client.get(f"/runs/{run}")["started"])}
        passing = next((p for p in list(conveyor.passed) if run_of(p, [{"id": run}], started_s)), None)
        if passing is not None:
            with contextlib.suppress(GoneError, NotFoundError), attach(station) as ring:  # the station may have ended
                story.sightings[run] = look_at(ring, bay, passing)
    return any(bay["use"] in ("filming", "stitching") for bay in station["ring"]["bays"])


def _scores(scenario: Scenario, passed: Sequence[Any], story: _Story, saboteur: Saboteur) -> tuple[BoardScore, ...]:
    resolution = [camera.px_per_mm for camera in Twin(scenario).cameras]
    started_s = {run["id"]: _host_s(run["started"]) for run in story.runs}
    by_id = {run["id"]: run for run in story.runs}
    scores = []
    for passing in passed:
        run = run_of(passing, story.runs, started_s)
        evidence = Evidence(
            passing,
            by_id.get(run) if run else None,
            story.matrices.get(run, {}) if run else {},
            story.sightings.get(run) if run else None,
            resolution,
        )
        scores.append(score(evidence, saboteur.troubles))
    return tuple(scores)


def _recoveries(saboteur: Saboteur, watch: Watch, began_ns: int) -> tuple[Recovery, ...]:
    """How long the station took after every device that was back."""
    result = []
    for back in saboteur.backs:
        watch.wait_ready(READY_S)
        ready_ns = watch.ready_since(back.back_ns)
        if ready_ns is not None:
            saboteur.mend(back, ready_ns)
        after_s = None if ready_ns is None else round((ready_ns - back.back_ns) * 1e-9, 2)
        back_s = round((back.back_ns - began_ns) * 1e-9, 2)
        result.append(Recovery(fault=back.fault.kind, back_s=back_s, ready_after_s=after_s))
    return tuple(result)


def _report(
    plan: Plan,
    boards: tuple[BoardScore, ...],
    story: _Story,
    recoveries: tuple[Recovery, ...],
    strays: int,
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
        faults=plan.fault_words,
        boards=boards,
        boards_missed=story.missed,
        stray_pulses=strays,
        rms_px=round(math.sqrt(sum(d.views * d.rms_px**2 for d in placed) / views), 4) if views else 0.0,
        max_px=max((d.max_px for d in placed), default=0.0),
        recoveries=recoveries,
        load=story.load,
        machine_load=round(os.getloadavg()[0], 2),
        took_s=round(took_s, 1),
        failings=(),
    )
    found = (*failings(report, plan.faults, plan.boards), *failed)
    return report.model_copy(update={"ok": not found, "failings": found})


def _processes(service: Service, station: dict[str, Any]) -> dict[str, int]:
    children = {p["name"]: p["pid"] for p in station.get("processes", ()) if p["pid"] is not None}
    return {"station": service.pid, **children}


def _everybody(service: Service, station: dict[str, Any], devices: Devices) -> dict[str, int | None]:
    renamed = {name.replace("worker ", "workers "): pid for name, pid in _processes(service, station).items()}
    cameras = {f"cameras {n}": camera.pid for n, camera in enumerate(devices.cameras)}
    return {**renamed, **cameras, "chip": devices.chip.pid, "rig": os.getpid()}


def _latest(client: Client) -> Any:
    """A first run that ended before anybody waited for it."""
    try:
        return client.get("/runs/latest")
    except NotFoundError:
        return None


def _matrices(client: Client, run: str) -> dict[str, Any]:
    try:
        return dict(client.get(f"/runs/{run}/matrices"))
    except NotFoundError:  # the run has failed before there were any
        return {}


def _host_s(utc: str) -> float:
    """CLOCK_MONOTONIC of a recent time of day."""
    return datetime.fromisoformat(utc).timestamp() - time.time() + time.monotonic()
