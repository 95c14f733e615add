"""The station: its parts built from one configuration, started and stopped in order.

    store → ring → workers → conductor → acquisition, and back again.

Whatever happens on the way up or down, nothing stays in shared memory and no process is left over.
"""

from __future__ import annotations

import logging
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from types import FrameType

from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import StationConfig
from vaoi_station.errors import DeviceError, InternalError, StateError
from vaoi_station.files import read_calibration
from vaoi_station.runs.acquisition_link import AcquisitionLink, Launch, spawned
from vaoi_station.runs.archive import Archive
from vaoi_station.runs.conductor import StationConductor
from vaoi_station.runs.core import Parts
from vaoi_station.runs.events import EventLog
from vaoi_station.runs.moments import RunIds
from vaoi_station.runs.order import OrderDesk
from vaoi_station.runs.salvage import camera_heads
from vaoi_station.runs.systemd import alive, notify
from vaoi_station.runs.workers import WorkerPool
from vaoi_station.store import BoardTypeDirectory, Database, Store

_log = logging.getLogger(__name__)

GRACE_S = 10.0
"""For runs under way to come to their end when the station is stopped."""
HTTP_GRACE_S = 5.0
DATABASE = "station.db"


class Station:
    """All processes and threads but the web server; a context manager."""

    def __init__(self, config: StationConfig, launch: Launch | None = None) -> None:
        """`launch` starts the acquisition process; by default the real one."""
        self.config = config
        self._launch = launch
        self._parts = ExitStack()
        self._conductor: StationConductor | None = None
        self._wound_down = False

    @property
    def conductor(self) -> StationConductor:
        """What answers; `StateError` while the station is down."""
        if self._conductor is None:
            raise StateError("The station is not running.", action="Start it.")
        return self._conductor

    def start(self) -> None:
        """Build and start everything; on a failure everything is taken down again and the failure is told."""
        config = self.config
        with ExitStack() as parts:
            calibration = read_calibration(config.calibration, len(config.cameras))
            store = Store(Database(config.data / DATABASE))
            parts.callback(store.close)
            ring = parts.enter_context(Ring.create(ring_path(config), RingLayout.of(config)))
            events = EventLog(store)
            workers = WorkerPool(config.workers, ring.path)
            link = AcquisitionLink(self._launch or spawned(config, ring.path))
            archive = Archive(store, events)
            conductor = StationConductor(
                Parts(config, ring, link, workers, archive, events, RunIds(store.newest_run())),
                ring,
                BoardTypeDirectory(config.board_types),
                OrderDesk(config.line, calibration, camera_heads(config), store),
                lambda: (link.status(), *workers.status()),
                alive,
            )
            parts.callback(conductor.close)
            conductor.start()
            parts.callback(workers.stop)
            workers.start(conductor.worker_lost)
            parts.callback(link.stop)
            link.start(conductor.hear, conductor.acquisition_lost)
            if ring.lock_note:
                events.add("trouble", ring.lock_note, code="ring-not-locked")
            self._parts, self._conductor, self._wound_down = parts.pop_all(), conductor, False

    def wind_down(self) -> None:
        """Film no more; runs under way come to their end. What is there can still be asked for."""
        if self._conductor is not None and not self._wound_down:
            self._wound_down = True
            self._conductor.wind_down(GRACE_S)

    def stop(self) -> None:
        """Take everything down; harmless when down."""
        self.wind_down()
        self._conductor = None
        self._parts.close()

    def __enter__(self) -> Station:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def serve(config: StationConfig, port: int | None = None) -> None:
    """The whole service, until SIGTERM or SIGINT."""
    address = (config.api.host, config.api.port if port is None else port)
    with _signals() as asked, _listener(*address) as listener, Station(config) as station:
        web = WebServer(station, listener, asked)
        web.start()
        notify("READY=1")
        asked.wait()
        notify("STOPPING=1")
        station.wind_down()
        web.stop()
        web.check()


class WebServer:
    """uvicorn in a thread of its own, so that signals stay the station's."""

    def __init__(self, station: Station, listener: socket.socket, ended: threading.Event) -> None:
        import uvicorn

        from vaoi_station.api import create_app

        self._listener, self._ended, self._asked = listener, ended, False
        self._server = uvicorn.Server(
            uvicorn.Config(
                create_app(station.conductor),
                log_config=None,
                access_log=False,
                timeout_graceful_shutdown=int(HTTP_GRACE_S),
            )
        )
        self._thread = threading.Thread(target=self._run, name="api", daemon=True)

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()
        host, port = self._listener.getsockname()[:2]
        _log.info("listening on http://%s:%s", f"[{host}]" if ":" in host else host, port)

    def stop(self) -> None:
        """Finish what is being answered, then end."""
        self._asked = self._thread.is_alive()
        self._server.should_exit = True
        self._thread.join(2 * HTTP_GRACE_S)

    def check(self) -> None:
        """Raise InternalError if it ended without being asked to."""
        if not self._asked:
            raise InternalError("The web server ended by itself; the log says why.")

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._listener])
        finally:
            self._ended.set()  # without its web server the station is of no use


def _listener(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise DeviceError(
            f"[api]: cannot listen on {host} port {port} ({error.strerror}).",
            action="Stop the other station, or set another port.",
        ) from error


@contextmanager
def _signals() -> Iterator[threading.Event]:
    """An event that SIGTERM and SIGINT set; their handlers are put back afterwards."""
    asked = threading.Event()

    def ask(number: int, _: FrameType | None) -> None:
        _log.info("stopping on %s", signal.Signals(number).name)
        asked.set()

    before = {number: signal.signal(number, ask) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
