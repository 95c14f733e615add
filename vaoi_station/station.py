"""The station: all parts, built from one configuration, started and stopped in order.

    store → ring → coordinator → workers → acquisition process

The parts start in this order and stop in the reverse order. Even if starting or stopping fails, nothing stays in shared
memory, and no process continues to run.
"""

from __future__ import annotations

import logging
import os
import threading
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from vaoi_station.acquisition.cameras.aravis.recovery import END_S
from vaoi_station.acquisition.process.backends import row_lights
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.calibration.nominal_view import nominal_matrix
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_calibration
from vaoi_station.files.access_keys import AUDIT_FILE, KEY_FILE, KeyFile
from vaoi_station.hermes.service import HermesService
from vaoi_station.model import Calibration, Reason
from vaoi_station.push.cfx_messages import Facts
from vaoi_station.push.publisher import Publisher
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.housekeeping import Housekeeping, Retention
from vaoi_station.runs.control.acquisition_link import AcquisitionLink, Launch, spawn_launcher
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.control.core import Parts
from vaoi_station.runs.control.order_requests import MakeOrder
from vaoi_station.runs.handover.handover import Handover
from vaoi_station.runs.host.machine import RemountWatch
from vaoi_station.runs.host.processes import no_collections
from vaoi_station.runs.host.service import StatusNotice, StopRequest, Supervisor, notify, until_started
from vaoi_station.runs.run.memory import BayGrants
from vaoi_station.runs.run.order import OrderFactory
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.standing_order import StandingOrder
from vaoi_station.runs.states.run_ids import RunIds, utc
from vaoi_station.runs.trends.figures import figures_of
from vaoi_station.runs.workers.pool import WorkerPool
from vaoi_station.store import BoardTypeDirectory, Database, Store
from vaoi_station.supervised_thread import SupervisedThread, ThreadFault

if TYPE_CHECKING:
    from vaoi_station.api.routes.waiting_page import WaitingPage

_log = logging.getLogger(__name__)

RETENTION_S, DOCUMENTS_S = 60.0, 3600.0
"""Periods of housekeeping: deletion of old runs, of unused documents, and the check of a piece of the database."""
GRACE_S = 10.0
"""Longest wait for unfinished runs to end when the station is stopped, beside the time of the board that passes."""
STOP_S = 20.0
"""Time after that for which systemd waits until all processes have ended."""
CLOSING_S = 5.0
"""Longest time in which the acquisition process closes its devices, beside a command that switches a camera's power."""
REMOUNT_S = 5.0
"""Period of the check whether a disk that was read-only is writable again."""
REPORT_S = 1.0
"""Longest wait for the event that reports the fault of a thread."""
EXIT_FAULT = 4
"""Exit code of a station that cannot continue: an internal error."""
DATABASE, REFERENCES = "station.db", "references"


class Station:
    """All processes and threads of the station except the web server; a context manager that starts and stops them."""

    def __init__(
        self,
        config: StationConfig,
        launch: Launch | None = None,
        on_fault: Callable[[], object] = lambda: None,
        remount: RemountWatch | None = None,
    ) -> None:
        """Prepare a station.

        Args:
            config: the station.
            launch: starts the acquisition process; None starts the real one.
            on_fault: called after a thread has ended or hangs, and an event was written. Because no run can end without
                this thread, a service exits here and is started again.
            remount: the watch over the mount of the data directory; None: nothing starts the process again.
        """
        self.config = config
        self._launch, self._on_fault, self._remount = launch, on_fault, remount
        self._parts, self._wound_down = ExitStack(), False
        self._supervisor: Supervisor | None = None
        self._coordinator: StationCoordinator | None = None
        self.publishers: tuple[Publisher, ...] = ()
        """What publishes the events of the running station, one for each broker."""
        self.line: HermesService | None = None
        """The connections of the running station to its neighbours; None if they do not speak Hermes."""

    @property
    def coordinator(self) -> StationCoordinator:
        """The coordinator of the running station. Access raises `StateError` while the station is not running."""
        if self._coordinator is None:
            raise StateError("The station is not running.", action="Start it.")
        return self._coordinator

    def start(self) -> None:
        """Build and start all parts. If one part fails, stop the parts that were started and raise its error."""
        config = self.config
        with ExitStack() as parts:
            calibration, uncalibrated = _calibration(config)
            store = Store(database := Database(config.data / DATABASE))
            parts.callback(store.close)
            store.configurations.begin(config.model_dump_json(), utc())
            ring = parts.enter_context(Ring.create(ring_path(config), RingLayout.of(config)))
            events = EventLog(store)
            # Workers and the acquisition process open the ring by its path, so the ring must exist before they start.
            workers = WorkerPool(config.workers, ring.path)

            def to_open() -> StationConfig:
                return coordinator.to_open()  # it is built below

            link = AcquisitionLink(self._launch or spawn_launcher(to_open, ring.path))
            grants = BayGrants(ring.blacken, link)
            archive = Archive(store, events, config.flat_fields)
            watch = CalibrationWatch(store.checks, events, calibration, [c.name for c in config.cameras], config.heads)
            cameras, board_types = calibration.cameras(config.heads), BoardTypeDirectory(config.board_types)
            shelf = ReferenceStore(config.data / REFERENCES, store, cameras)
            shelf.sweep()
            housekeeping = _housekeeping(config, store, events)
            make_order: MakeOrder = (
                partial(_refuse_order, uncalibrated)
                if uncalibrated
                else OrderFactory(config, calibration, store, shelf, row_lights(config))
            )
            missing = () if uncalibrated is None else (Reason.of(uncalibrated),)
            standing = StandingOrder(store.standing)
            resumed = standing.resume(board_types.get, make_order)
            # Whom a station talks to: brokers, an archive of the plant, its neighbours in the line.
            handover = _handover(config, events, archive)
            line = HermesService.of(config, events)
            receivers: list[Handover | HermesService | Publisher] = [one for one in (handover, line) if one is not None]
            supervisor = Supervisor(lambda: notify("WATCHDOG=1"), lambda faults: self._report(events, faults))
            coordinator = StationCoordinator(
                Parts(
                    config,
                    ring.renew,
                    grants,
                    workers,
                    archive,
                    events,
                    RunIds(store.newest_run()),
                    watch,
                    standing,
                    resumed,
                    lambda: (*missing, *(reason for receiver in receivers for reason in receiver.reasons())),
                    tuple(camera.px_per_mm for camera in cameras),
                    store.standing,
                    partial(_use_calibration, config, shelf, make_order),
                    partial(self._use_config, store),
                ),
                ring,
                board_types,
                make_order,
                shelf,
                lambda: (link.status(), workers.fork_server.status(), *workers.status()),
                lambda: tuple(map(_reason_of, supervisor.faults())),
                StatusNotice(),
            )
            receivers.extend(publishers := _publishers(config, events, archive, coordinator))
            if (remount := self._remount) is not None:
                housekeeping.add(lambda: remount.check(archive.count_at_risk()), REMOUNT_S, code="storage-read-only")
            housekeeping.add(coordinator.sweep_references, RETENTION_S, code="retention")
            housekeeping.add(coordinator.kept.tend, RETENTION_S, code="retention")
            for begin, end in (
                (coordinator.start, coordinator.close),
                (grants.start, grants.stop),
                (partial(workers.start, coordinator.worker_ended, coordinator.workers_ready), workers.stop),
                (
                    partial(link.start, coordinator.acquisition_message, coordinator.acquisition_ended, workers.warm),
                    partial(link.stop, CLOSING_S + self._power_s),
                ),
                (housekeeping.start, housekeeping.stop),
            ):
                # The exit stack calls in reverse order: the link stops first, then the workers, then the coordinator,
                # which thus receives the last reports of both.
                parts.callback(end)
                begin()
            if ring.lock_note:
                events.add("trouble", ring.lock_note, code="ring-not-locked")
            supervisor.watch(
                *(part.thread for part in (database, coordinator, grants, workers, link, housekeeping)),
                coordinator.kept.recordings.thread,
                coordinator.kept.identities.queue.thread,
                coordinator.heights.queue.thread,
                coordinator.parts.queue.thread,
                coordinator.kept.mosaics.queue.thread,
            )
            parts.callback(supervisor.stop)
            supervisor.start()
            # Broker and archive come last, and go first: the line waits for none of them.
            if handover is not None:
                parts.enter_context(handover.running(coordinator.kept.recordings))
                coordinator.kept.archive_status = handover.status
                supervisor.watch(handover.thread)
            for publisher in publishers:
                parts.enter_context(publisher.running(supervisor.watch))
            if line is not None:
                parts.enter_context(line.running(supervisor.watch, coordinator.orders))
            self._supervisor, self.publishers, self.line = supervisor, publishers, line
            self._parts, self._coordinator, self._wound_down = parts.pop_all(), coordinator, False

    @property
    def _power_s(self) -> float:
        """Longest time of a command for a camera's power, which the end of the station must not cut short."""
        return self.config.camera_power.limit_s + END_S if self.config.camera_power else 0.0

    def watch(self, thread: SupervisedThread) -> None:
        """Supervise a thread of the running station that the caller has started, such as that of its web server."""
        assert self._supervisor is not None, "start() sets it"
        self._supervisor.watch(thread)

    def _use_config(self, store: Store, config: StationConfig) -> None:
        """Use another configuration for the next acquisition process, and for the runs of later orders."""
        self.config = config
        store.configurations.begin(config.model_dump_json(), utc())

    def _report(self, events: EventLog, faults: Sequence[ThreadFault]) -> None:
        """Publish that threads have ended or hang, then let the owner act."""
        for fault in faults:
            _log.critical("%s", fault)
            # The event log may be the thread that hangs. So a separate thread writes the event, and its end is not
            # awaited for long.
            write = threading.Thread(
                target=lambda text=str(fault): events.add("trouble", text, code="thread-lost"), daemon=True
            )
            write.start()
            write.join(REPORT_S)
        self._on_fault()

    def wind_down(self) -> None:
        """Film no more boards, and wait for the unfinished runs to end. Requests are still answered."""
        if self._coordinator is not None and not self._wound_down:
            self._wound_down = True
            limit_s = self._coordinator.grace_s + GRACE_S
            # A slow belt may need longer than TimeoutStopSec of the unit, which stays as short as it can be.
            notify(f"EXTEND_TIMEOUT_USEC={round((limit_s + STOP_S + self._power_s) * 1e6)}")
            self._coordinator.wind_down(limit_s)

    def stop(self) -> None:
        """Stop all parts. A second call does nothing."""
        self.wind_down()
        self._coordinator = None
        self._parts.close()

    def __enter__(self) -> Station:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def _calibration(config: StationConfig) -> tuple[Calibration, StateError | None]:
    """Return the calibration, or while there is none the nominal one, and why the line cannot be armed with it."""
    heads = config.heads
    try:
        return read_calibration(config.calibration, heads), None
    except NotFoundError:
        if any(head.nominal_center_mm is None or head.nominal_px_per_mm is None for head in heads):
            raise
    matrices = tuple(nominal_matrix(head, i) for i, head in enumerate(heads))
    nominal = Calibration(format="vaoi-calibration", version=1, unit="mm", camera_matrices=matrices)
    _log.warning("%s does not exist: cameras can be set up, and the line cannot be armed", config.calibration)
    return nominal, StateError(
        f"{config.calibration} does not exist: the array is not calibrated yet.",
        action="Stop the station, film the calibration board (vaoi record --still), use vaoi calibrate, start it.",
        code="no-calibration",
    )


def _use_calibration(config: StationConfig, shelf: ReferenceStore, orders: MakeOrder, other: Calibration) -> None:
    """Use another calibration for references, and for the runs of later orders."""
    shelf.use_cameras(other.cameras(config.heads))
    if isinstance(orders, OrderFactory):
        orders.use_calibration(other)


def _publishers(
    config: StationConfig, events: EventLog, archive: Archive, coordinator: StationCoordinator
) -> tuple[Publisher, ...]:
    """Return what publishes the events of the station, and what its messages tell besides."""

    def figures(run: str) -> dict[str, float]:
        ended = archive.get(run)
        return figures_of(ended.detail, ended.stitch)

    return Publisher.of(config, events, Facts(coordinator.snapshot, coordinator.run, figures, coordinator.parts.known))


def _handover(config: StationConfig, events: EventLog, archive: Archive) -> Handover | None:
    """Return what hands finished runs to the archive of the plant; None without one."""
    if config.archive is None:
        return None
    # A run that is not stored yet is on the belt or with the workers.
    return Handover(config.archive, config.name, events, lambda: archive.count_at_risk() > 0)


def _refuse_order(refusal: StateError, *_: object) -> NoReturn:
    raise refusal


def _reason_of(fault: ThreadFault) -> Reason:
    action = "The station ends and is started again by systemd."
    return Reason(code="thread-lost", message=str(fault), action=action)


def _housekeeping(config: StationConfig, store: Store, events: EventLog) -> Housekeeping:
    """Return the thread that forgets old runs and documents."""
    housekeeping, retention = Housekeeping(events), Retention(config.keep, store.retention)
    housekeeping.add(retention.sweep, RETENTION_S, code="retention")
    housekeeping.add(retention.forget_unused, DOCUMENTS_S, code="retention")
    housekeeping.add(lambda: store.configurations.store_again(utc()), RETENTION_S, code="retention")
    return housekeeping


def serve(config: StationConfig, port: int | None = None, file: Path | None = None) -> None:
    """Run the station and its web server until SIGTERM or SIGINT.

    `port` replaces the configured port; `file` is the station.toml, to examine the station or set it up.
    """
    with no_collections():
        from vaoi_station.api.certificate import CertificateFiles
        from vaoi_station.api.web_server import WebServer, open_listener

    api, keys = config.api, KeyFile(config.data / KEY_FILE)
    address, names = (api.host, api.port if port is None else port), (api.host, *api.names)
    tls = None if api.certificate is None else CertificateFiles(api.certificate, api.private_key)
    with StopRequest() as stop, ExitStack() as parts:
        remount = RemountWatch(config.data, stop.request)
        socket_ = until_started(stop, lambda: open_listener(*address, "[api]"))
        if socket_ is None:
            return
        parts.enter_context(socket_)
        with ExitStack() as waiting:
            pages: list[WaitingPage] = []

            def report(error: VaoiError) -> None:
                from vaoi_station.api.routes.waiting_page import WaitingPage

                if not pages:
                    pages.append(waiting.enter_context(WaitingPage(socket_, names, tls, api.root_path)))
                pages[0].report(error)

            station = until_started(stop, lambda: _started(config, remount), report)
        if station is None:
            return
        parts.callback(station.stop)
        with no_collections():
            # Imported only now, which takes a second: meanwhile the fork server and the acquisition process start.
            from vaoi_station.api.access import AccessControl
            from vaoi_station.api.app import create_app
            from vaoi_station.api.audit import AuditLog
            from vaoi_station.api.setup.station_files import StationFiles
        _check_keys(keys, is_open=api.open_loopback and api.host in ("127.0.0.1", "::1", "localhost"))
        audit = AuditLog(config.data / AUDIT_FILE)
        parts.callback(audit.close)  # what was noted last is written before the process ends
        access = AccessControl(keys, audit, open_loopback=api.open_loopback)
        files = None if file is None else StationFiles(file.resolve(), config)
        with no_collections():
            root = api.root_path
            app = create_app(station.coordinator, names, access, station.publishers, file, files, root, station.line)
        web = WebServer(app, socket_, stop.request, tls=tls)
        web.start()
        station.watch(web.thread)
        station.watch(audit.thread)
        notify("READY=1")
        if name := stop.wait():
            _log.info("stopping on %s", name)
        notify("STOPPING=1")
        station.wind_down()
        web.stop()
        web.check()
    web.end_process_if_left()


def _check_keys(keys: KeyFile, *, is_open: bool) -> None:
    """Log that callers from outside are refused. A file that cannot be used keeps no board from being filmed."""
    try:
        if not keys.entries() and not is_open:
            _log.warning("there is no key yet, so callers from outside are refused; make one with vaoi keys create")
    except VaoiError as error:
        _log.error("callers with a key are refused until the file can be used: %s", error)


def _started(config: StationConfig, remount: RemountWatch) -> Station:
    # A station that cannot write yet films nevertheless, if there is a database; its housekeeping reports the cause.
    with suppress(DeviceError):
        remount.check()
    station = Station(config, on_fault=_exit, remount=remount)
    station.start()
    return station


def _exit() -> None:
    """End this process at once, as a crash would; systemd starts the station again.

    An orderly end would wait for the thread that has ended or hangs. The other processes end when their pipes close.
    """
    logging.shutdown()
    os._exit(EXIT_FAULT)
