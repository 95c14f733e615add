"""Soak the station process alone: `python -m tests.soak.alone.station --boards 12000`.

Coordinator, database, housekeeping and REST service are those of a station. Boards come from a scripted acquisition
process as fast as their results are announced, and scripted workers stitch them, so that a board costs the time of
what keeps, announces and forgets it. The limits of [keep] are low: everything is in its steady state after some hundred
boards, and only what grows without end grows on. Prints memory and the number of objects of Python over the boards.
"""

from __future__ import annotations

import argparse
import http.client
import json
import pickle
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

from tests.runs.conftest import Done, ScriptedWorkers, a_board_type, a_calibration, a_config
from tests.runs.conftest import Rig as ScriptedLine
from tests.runs.peer import PATIENCE_S, Peer
from tests.soak.alone.memory import database_mb, heaps_mb, objects, trimmed_mb
from vaoi_station import station as station_module
from vaoi_station.acquisition.process import messages
from vaoi_station.acquisition.ring import Ring, ring_path
from vaoi_station.api import create_app
from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.config import StationConfig
from vaoi_station.errors import GoneError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.runs.control import acquisition_link
from vaoi_station.runs.states.schemas import ProcessStatus
from vaoi_station.runs.workers.fork_server_link import ForkServerLink
from vaoi_station.runs.workers.jobs import ConcludeJob, Job, LinkJob, Reply
from vaoi_station.station import Station
from vaoi_station.supervised_queue import SupervisedQueue

KEPT = {"results": 60, "doubtful_results": 30, "runs": 200, "database_gb": 0.05, "recordings_gb": 0.01}
"""Limits of [keep], lower than station.toml allows."""
ROWS = 3


class Point(NamedTuple):
    """What the process uses after a number of boards."""

    boards: int
    private_mb: float
    """Private memory, once the C library has given back what it can."""
    heaps_mb: float
    """In use of the heaps of the C library."""
    database_mb: float
    """Of these by SQLite."""
    blocks: int
    """Blocks of memory that Python has allocated for small objects."""
    objects: int

    def __str__(self) -> str:
        return (
            f"{self.boards} boards: {self.private_mb:.3f} MB, heaps {self.heaps_mb:.3f} MB, of these the database "
            f"{self.database_mb:.3f} MB; {self.blocks} blocks, {self.objects} objects of Python"
        )


class ThreadedWorkers(ScriptedWorkers):
    """Scripted workers in the place of the pool: a thread performs the jobs, whose replies are pickled as in a pipe."""

    def __init__(self, *_: object) -> None:
        super().__init__()
        self._queue: SupervisedQueue[tuple[Job, Done]] = SupervisedQueue(self._perform, "workers", 1000)
        self.thread = self._queue.thread
        self.fork_server = ForkServerLink(print, 1)

    def start(self, *_: object) -> None:
        self._queue.start()

    def stop(self) -> None:
        self._queue.stop()

    def warm(self) -> bool:
        return True

    def status(self) -> tuple[ProcessStatus, ...]:
        return ()

    def submit(self, job: Job, done: Done) -> None:
        self._queue.put((job, done))

    def _perform(self, item: tuple[Job, Done]) -> None:
        job, done = pickle.loads(pickle.dumps(item[0])), item[1]
        self.receivers = {id(job): lambda reply: done(pickle.loads(pickle.dumps(reply)))}
        if isinstance(job, LinkJob | ConcludeJob):
            self.perform(job)
        else:
            done(Reply.refused(GoneError("There are no frames.", action="None.", code="frames-gone")))
        # What a test compares later would be kept for ever here.
        self.done.clear()

    def open_run(self, opening: object) -> None:
        pass

    def close_run(self, run: str) -> None:
        pass


class Caller:
    """A tester: it waits for the result of each board, and asks for the state of the station."""

    def __init__(self, port: int) -> None:
        self._port, self._after = port, ""

    def next_result(self) -> None:
        """Wait until the next run is announced."""
        # Without `after`, a run that was announced before the request is not waited for: the first one may have been.
        path = f"runs/next?timeout=5&after={self._after}" if self._after else "runs/latest"
        while True:
            status, content = self._get(path)
            if status == 200:
                self._after = str(json.loads(content)["id"])
                self._get("station")
                return
            assert status == 204 or not self._after, content

    def _get(self, path: str) -> tuple[int, bytes]:
        # A connection of its own: the station ends one that is idle for as long as a board may take on a busy machine.
        with closing(http.client.HTTPConnection("127.0.0.1", self._port, timeout=PATIENCE_S)) as link:
            link.request("GET", f"/api/v1/{path}")
            answer = link.getresponse()
            return answer.status, answer.read()


def soak(folder: Path, boards: int, every: int) -> Iterator[Point]:
    """Let boards pass, and yield what the process uses after each `every`."""
    config = a_config(folder, runs=6)
    config = config.model_copy(update={"keep": config.keep.model_copy(update=KEPT)})
    write_board_type(config.board_types / "small.json", a_board_type())
    write_calibration(config.calibration, a_calibration())
    with ExitStack() as parts:
        # A scripted process sends no heartbeats, and its first message comes late on a busy machine.
        for limit in ("HEARTBEAT_LIMIT_S", "START_LIMIT_S"):
            parts.enter_context(patch.object(acquisition_link, limit, float("inf")))
        parts.enter_context(patch.object(station_module, "WorkerPool", ThreadedWorkers))
        peer = Peer()
        station = Station(config, launch=peer.launch)
        station.start()
        parts.callback(_stop, station, peer)
        line = _line(config, station, peer, parts)
        caller = _served(station, parts)
        grant = line.arm()
        for board in range(1, boards + 1):
            line.board(grant, ROWS)
            caller.next_result()
            grant = _granted(peer)
            if board % every == 0:
                tracked, private = objects(), trimmed_mb()
                yield Point(board, private, heaps_mb(), database_mb(), sys.getallocatedblocks(), tracked)


def _served(station: Station, parts: ExitStack) -> Caller:
    """Serve a station; return a caller."""
    listener = parts.enter_context(open_listener("127.0.0.1", 0, "the soak"))
    web = WebServer(create_app(station.coordinator, publisher=station.publisher), listener, threading.Event().set)
    web.start()
    parts.callback(web.stop)
    return Caller(listener.getsockname()[1])


def _line(config: StationConfig, station: Station, peer: Peer, parts: ExitStack) -> ScriptedLine:
    """Return the scripted line of a station."""
    ring = parts.enter_context(Ring.attach(ring_path(config), writable=True))
    unused: Any = None
    line = ScriptedLine(config, station.coordinator, ring, peer, *(unused,) * 4)
    line.ready()
    return line


def _granted(peer: Peer) -> messages.Grant:
    """Return the next grant; commands before it need no answer."""
    while True:
        assert peer.connection.poll(PATIENCE_S), "no memory was granted"
        if isinstance(command := peer.connection.recv(), messages.Grant):
            return command


def _stop(station: Station, peer: Peer) -> None:
    """Stop a station whose scripted process does not read Shutdown: it ends when it is closed."""
    ending = threading.Thread(target=station.stop)
    ending.start()
    peer.close()
    ending.join()


def main() -> None:
    """Let boards pass, and print what they leave behind."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak.alone.station", description=__doc__)
    parser.add_argument("--boards", type=int, default=12_000)
    parser.add_argument("--every", type=int, default=1000, help="number of boards between two lines")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="vaoi-soak-") as folder:
        for point in soak(Path(folder), chosen.boards, chosen.every):
            print(point, flush=True)


if __name__ == "__main__":
    main()
