"""The snapshot of the station, which the status page and the REST request `GET station` show."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from vaoi_station.acquisition.cameras.interface import CameraPtp, CameraRecovery
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.host.machine import is_present
from vaoi_station.runs.merging.flat_field_warnings import flat_field_warnings
from vaoi_station.runs.run.run_views import versions
from vaoi_station.runs.states.run_ids import utc_of_host
from vaoi_station.runs.states.schemas import (
    STARTING,
    CameraPtpStatus,
    CameraRecoveryStatus,
    CameraStatus,
    LineOutputStatus,
    ProcessStatus,
    Retention,
    RingStatus,
    StationSnapshot,
)
from vaoi_station.runs.states.tables import StationState
from vaoi_station.store.documents import EVENTS_KEPT

NEXT_ORDERS = 5
"""Number of orders in the snapshot."""
_COMPILE_NOTE = "After an installation or an update they compile for a minute or two."


def snapshot_of(
    core: Core,
    parts: Parts,
    *,
    ring: tuple[Path, int],
    processes: tuple[ProcessStatus, ...],
    faults: tuple[Reason, ...],
) -> StationSnapshot:
    """Build the snapshot of the station, in the coordinator's thread. `ring`: path and size, bytes, of the ring."""
    config, filming, cameras = core.config, core.filming, _cameras(core, core.config)
    held = line_held(core, config, lambda: processes, faults)
    output, orders = core.health.line_output if core.health else None, core.line.orders
    order = orders.next
    return StationSnapshot(
        name=config.name,
        state=core.machine.state,
        since=core.machine.since,
        reasons=(*faults, *core.machine.reasons.all(), *readiness.reasons(core.health, config.cameras)),
        warnings=(
            *core.trigger.warnings(),
            *core.watch.warnings(),
            *core.line.warnings(),
            *core.storage.warnings(),
            *readiness.ptp_warnings(core.health, config.cameras),
            *_address_warnings(config),
            *flat_field_warnings(config, order.setup.lights if order is not None else ()),
            *worker_warnings(processes),
            # A full place behind the cameras holds the next board back, and is no fault.
            *(reason for reason in core.other_warnings() if reason.code not in readiness.EXPECTED),
        ),
        set_aside=core.storage.set_aside(),
        armed_with=orders.shown(),
        next_order=core.line.next_order,
        orders=orders.listed(NEXT_ORDERS),
        orders_waiting=len(orders.queue.kept),
        cameras=cameras,
        all_cameras_ready=all(camera.connected for camera in cameras),
        line_ready=not held,
        line_held=held,
        line_output=None if output is None else LineOutputStatus(high=output.high, why=output.why),
        controller=core.health.controller if core.health else "",
        processes=processes,
        ring=RingStatus(path=str(ring[0]), size_bytes=ring[1], bays=core.memory.bays(), leases=core.memory.leases()),
        versions=versions(),
        retention=_retention(config),
        last_run=_last_run(parts.archive),
        filming=filming[0].run if filming else None,
        last_event=parts.events.last,
        boards_missed=core.boards.missed,
        times_blocked=core.line.times_blocked,
    )


def line_held(
    core: Core, config: StationConfig, processes: Callable[[], tuple[ProcessStatus, ...]], faults: tuple[Reason, ...]
) -> tuple[Reason, ...]:
    """Return why the next board must wait; empty if it may come. Call it in the coordinator's thread."""
    state, orders = core.machine.state, core.line.orders
    order = orders.next
    # Only of an armed line is everything evaluated: this runs after every message while frames are being settled.
    others = (*faults, *core.line.warnings(), *core.contacts.held())
    if state is StationState.ARMED:
        others += (*worker_warnings(processes()), *core.other_warnings())
    facts = readiness.LineFacts(
        state,
        core.line.expects_board,
        core.health,
        order is not None and order.despite_lost_cameras,
        others,
        time.monotonic(),
        orders.by_orders and order is None,
        core.storage.present(),
    )
    return readiness.held_back(facts, config.cameras)


def renew_permit(
    core: Core, parts: Parts, processes: Callable[[], tuple[ProcessStatus, ...]], faults: tuple[Reason, ...]
) -> None:
    """Let the next board come, or hold it back. The coordinator's thread calls this after every message."""
    held = line_held(core, parts.config, processes, faults)
    core.permit.update(held, core.boards.reports, time.monotonic())
    core.contacts.update(core.health.contacts if core.health else None, time.monotonic())
    if core.machine.state is StationState.ARMED:
        core.permit.publish([reason for reason in held if reason.code not in readiness.EXPECTED])


def status_line(core: Core) -> str:
    """Return state, order, runs under way and first reason in one line. Call it in the coordinator's thread."""
    order, runs = core.line.orders.shown(), len(core.active)
    parts = [f"{core.machine.state}{f' for board type {order.board_type!r}' if order else ''}"]
    if runs:
        parts.append(f"{runs} run{'' if runs == 1 else 's'} under way")
    if reason := next(iter(core.machine.reasons.all()), None):
        parts.append(reason.message)
    return "; ".join(parts)


def _address_warnings(config: StationConfig) -> tuple[Reason, ...]:
    host = config.api.host
    if is_present(host):
        return ()
    message = f"No interface of this machine has the address [api] host = {host}: callers cannot reach the station."
    return (Reason(code="address-absent", message=message, action="Check cable, network and station.toml."),)


def worker_warnings(processes: tuple[ProcessStatus, ...]) -> tuple[Reason, ...]:
    """Return one warning if workers are still starting, else none.

    No board is filmed before the workers are ready for the first time. Boards that are filmed while a worker is
    restarted may get their results later.
    """
    workers = [process for process in processes if process.name.startswith("worker ")]
    # "starting" lasts until a worker has opened the ring and compiled its inner loops.
    away = sum(worker.doing == STARTING for worker in workers)
    if not away:
        return ()
    still = f"{away} of {len(workers)} workers {'is' if away == 1 else 'are'} still starting"
    progress = next((f" ({worker.progress})" for worker in workers if worker.progress), "")
    effect = "Results of boards that pass meanwhile come late"
    if any(process.doing for process in processes if process.name == "acquisition"):
        effect = "No board is filmed yet"
    return (Reason(code="workers-starting", message=f"{effect}: {still}{progress}.", action=_COMPILE_NOTE),)


def _last_run(archive: Archive) -> str | None:
    # Callers must learn of a database that cannot be read, so that must not end their request.
    with suppress(DeviceError):
        latest = archive.latest()
        return None if latest is None else latest.detail.id
    return None


def _cameras(core: Core, config: StationConfig) -> tuple[CameraStatus, ...]:
    health = core.health
    # No health report yet: the acquisition process is opening the devices, or has ended.
    if health is None:
        waiting = core.machine.state in (StationState.STARTING, StationState.FAULTED)
        message = "not open yet" if waiting else "no report yet"
        return tuple(
            CameraStatus(camera=k, name=c.name, connected=False, message=message, **_camera_at(core, k))
            for k, c in enumerate(config.cameras)
        )
    return tuple(
        CameraStatus(
            camera=k,
            name=config.cameras[k].name,
            connected=seen.connected,
            message=seen.message,
            temperature_c=seen.temperature_c,
            delivered=seen.delivered,
            incomplete=seen.incomplete,
            last_frame_age_s=None if seen.last_frame_s is None else max(health.host_time_s - seen.last_frame_s, 0.0),
            next_try=None if seen.next_try_s is None else utc_of_host(seen.next_try_s),
            recovery=_recovery(seen.recovery),
            ptp=_ptp(seen.ptp),
            counters=dict(seen.counters),
            lost_since=core.lost_since.get(k),
            link=config.cameras[k].link or "",
            **_camera_at(core, k),
        )
        for k, seen in enumerate(health.cameras)
    )


def _camera_at(core: Core, place: int) -> dict[str, str]:
    return core.places.cameras[place].model_dump(exclude={"named"})


def _recovery(seen: CameraRecovery | None) -> CameraRecoveryStatus | None:
    if seen is None:
        return None
    return CameraRecoveryStatus.model_validate({"step": seen.step, "why": seen.why, "at": utc_of_host(seen.at_s)})


def _ptp(seen: CameraPtp | None) -> CameraPtpStatus | None:
    if seen is None:
        return None
    return CameraPtpStatus(
        state=seen.state, synchronised=seen.synchronised, offset_ns=seen.offset_ns, apart_us=seen.apart_s * 1e6
    )


def _retention(config: StationConfig) -> Retention:
    runs, keep, keep_s = config.ring.runs, config.keep, config.ring.keep_s
    return Retention(
        runs_in_memory=runs,
        lease_s=config.ring.lease_s,
        keep_s=keep_s,
        frames=(
            f"Frames of at most {runs} runs are in memory. A finished run keeps its frames while a caller holds it, "
            f"and for {keep_s:g} s after it was announced. While the line is armed, one place is kept for "
            "the next board: the oldest other finished run is evicted; if there is none, the line is blocked. "
            "A restart of the station loses all frames."
        ),
        results=(
            f"Results and records of the newest {keep.results} runs with verdict ok are kept in {config.data} for "
            f"{keep.days:g} days, of {keep.doubtful_results} others for {keep.doubtful_days:g} days, of pinned runs "
            f"without limit; summaries of {keep.runs} runs for {keep.run_days:g} days; all within "
            f"{keep.database_gb:g} GB."
        ),
        events=f"The last {EVENTS_KEPT} events are kept, also over restarts.",
    )
