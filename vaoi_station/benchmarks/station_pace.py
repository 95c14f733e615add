"""A whole station in real time: boards that the twin rendered beforehand pass again and again."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import statistics
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import count, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.cameras.interface import (
    Arrival,
    CameraDevice,
    CameraEvent,
    CameraExposure,
    CameraHealth,
    Slot,
)
from vaoi_station.acquisition.clocks import ClockReading, DeviceClock
from vaoi_station.acquisition.devices import Devices
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.acquisition.replay import RecordedRow, ReplayController
from vaoi_station.acquisition.ring import Ring, ring_path
from vaoi_station.benchmarks.process_usage import cpu_s, private_memory_bytes
from vaoi_station.benchmarks.tables import json_document, number, table
from vaoi_station.config import CameraConfig, ReplayConfig, RingConfig, StationConfig
from vaoi_station.errors import StateError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.line_config import Line
from vaoi_station.model import RecordingHead
from vaoi_station.rig.rendering import RenderedBoard, render_boards
from vaoi_station.runs.control.acquisition_link import Launch, Process
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.host.processes import set_up_process
from vaoi_station.runs.states.schemas import RunDetail, Timeline
from vaoi_station.simulation import Scenario, Twin
from vaoi_station.station import Station
from vaoi_station.supervised_thread import SupervisedThread

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]


@dataclass(frozen=True)
class PrerenderedRun(RenderedBoard):
    """The first board of a scenario with its frames in a file, and what a station needs to stitch them."""

    head: RecordingHead
    line: Line

    def map(self) -> NDArray[np.uint8]:
        """Return all frames, (rows, cameras, height, width) uint8, as a read-only memory map."""
        camera = self.head.cameras[0]
        return self.map_frames().reshape(self.rows, len(self.head.cameras), camera.height, camera.width)


def prerender(scenario: Scenario, directory: Path, report: Callable[[str], None] = lambda _: None) -> PrerenderedRun:
    """Render the first board of a scenario, unless the directory already holds it."""
    [board] = render_boards(scenario, [0], directory, report)
    twin = Twin(scenario)
    return PrerenderedRun(board.directory, twin.passage(0).head(), twin.line)


@dataclass(frozen=True)
class FillRequest:
    """A request to copy one prerendered frame into a slot. The sender returns the request when the slot is filled."""

    camera: int
    row: int
    slot: int


@contextlib.contextmanager
def run_frame_sender(run: PrerenderedRun) -> Iterator[tuple[int, Pipe]]:
    """Run the sender inside a `with` block; yield its process id and the station's end of its pipe, which ends it."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=fill_slots, args=(run, there), name="vaoi-bench-sender", daemon=True)
    process.start()
    # With the other end open here, closing the pipe would never reach the process as an end of file.
    there.close()
    assert process.pid is not None
    try:
        yield process.pid, here
    finally:
        here.close()
        process.join()
        process.close()


def fill_slots(run: PrerenderedRun, connection: Pipe) -> None:
    """Fill slots until the pipe is closed: receive the path of the ring, then requests; send each back when done."""
    set_up_process(one_thread=True)
    frames = run.map()
    with (
        contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError),
        connection,
        Ring.attach(Path(connection.recv()), writable=True) as ring,
    ):
        while True:
            request: FillRequest = connection.recv()
            ring.memory(request.slot)[:] = frames[request.row, request.camera].reshape(-1)
            # Sent only after the copy: the acquisition process takes the returned request as the arrival of the frame.
            connection.send(request)


class SenderConnection:
    """Connection from the acquisition process to the sender: it sends requests and turns replies into arrivals."""

    def __init__(self, connection: Pipe) -> None:
        self._connection = connection
        self._pending: dict[int, tuple[int, float]] = {}
        """Slot → frame id and time stamp of its arrival, for requests without a reply."""
        self._sending = threading.Lock()
        self._arrivals: SimpleQueue[CameraEvent] | None = None
        self.thread = SupervisedThread(self._receive, "sender-replies")

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Start to put arrivals into a queue. Each camera calls this method; only the first call has an effect."""
        if self._arrivals is None:
            self._arrivals = arrivals
            self.thread.start()

    def request(self, request: FillRequest, frame_id: int, time_s: float) -> None:
        """Request that the sender fills a slot. The arrival of the frame will have the given id and time stamp."""
        # Stored before the request is sent: the other thread may receive the reply before `send` returns.
        self._pending[request.slot] = frame_id, time_s
        with self._sending:
            self._connection.send(request)

    def _receive(self) -> None:
        assert self._arrivals is not None
        while True:
            try:
                with self.thread.waiting():
                    request: FillRequest = self._connection.recv()
            except (EOFError, OSError):
                self.thread.expect_end()
                # The sender ends with the benchmark; there is nothing left to deliver.
                return
            frame_id, time_s = self._pending.pop(request.slot)
            self._arrivals.put(Arrival(request.camera, request.slot, True, frame_id, time_s, time.monotonic()))


class SenderCamera(CameraDevice):
    """A `CameraDevice` whose slots are filled by the sender process."""

    def __init__(self, number: int, clock: DeviceClock, sender: SenderConnection) -> None:
        self.number = number
        self._clock, self._sender = clock, sender
        self._slots: deque[Slot] = deque()
        self._ids = count(1)
        self._delivered = self._without_slot = 0

    def start(self, arrivals: SimpleQueue[CameraEvent]) -> None:
        """Start to put arrivals into the queue `arrivals`."""
        self._sender.start(arrivals)

    def trigger(self, row: int, time_s: float) -> None:
        """Deliver the frame of a row into the next queued slot; drop the frame if no slot is queued."""
        # A dropped frame uses up an id as well: a real camera also counts frames for which there is no memory.
        frame_id = next(self._ids)
        try:
            slot = self._slots.popleft()
        except IndexError:
            self._without_slot += 1
            return
        self._delivered += 1
        self._sender.request(FillRequest(self.number, row, slot.number), frame_id, time_s)

    def set_exposure(self, wanted: CameraExposure) -> None:
        """Do nothing: the frames were rendered before."""

    def rewind(self) -> None:
        """Do nothing: there is no sequencer."""

    def sent_nothing(self, rows: int, since_s: float) -> None:
        """Do nothing: it does not hang."""

    def queue(self, slot: Slot) -> None:
        """Queue memory for a frame that is to come."""
        self._slots.append(slot)

    def take_back(self) -> list[int]:
        """Withdraw the slots that were queued and not used; return their numbers."""
        numbers = [slot.number for slot in self._slots]
        self._slots.clear()
        return numbers

    def read_clock(self) -> ClockReading:
        """Read the camera's clock, which is the same as the controller's clock."""
        return self._clock.read_exactly()

    def health(self) -> CameraHealth:
        """Return the counts of delivered and dropped frames."""
        message = f"{self._without_slot} frames found no free slot" if self._without_slot else ""
        return CameraHealth(True, message, None, self._delivered)

    def threads(self) -> tuple[SupervisedThread, ...]:
        """Return the thread that receives the sender's replies; all cameras share it."""
        return (self._sender.thread,)

    def close(self) -> None:
        """Do nothing: the connection ends with its pipe."""


PAUSE_S = 1.0
"""Pause between two boards at rate 1. At a higher rate the pause is divided by the rate."""
READY_S = 300.0
"""Time limit until the station is ready: processes start, workers compile and warm up."""
RUN_LIMIT_S = 180.0
"""Time limit for one run to end; after it the benchmark does not wait for further runs."""


def sender_devices(run: PrerenderedRun, rate: float, sender: Pipe, _: StationConfig) -> Devices:
    """Return the cameras, and a controller that repeats a run at a multiple of its rate without end."""
    clock, connection, head = DeviceClock(), SenderConnection(sender), run.head
    cameras = tuple(SenderCamera(n, clock, connection) for n in range(len(head.cameras)))

    def deliver(row: int, time_s: float) -> int:
        for camera in cameras:
            camera.trigger(row, time_s)
        return len(cameras)

    times_s = head.row_times_s() / rate
    rows = [
        RecordedRow(
            # Rounded to ns, as `RecordedRow` requires.
            round(float(times_s[row] - times_s[0]), 9),
            head.lights[row] if head.lights else "",
            (),
            partial(deliver, row),
        )
        for row in range(head.rows)
    ]
    return Devices(cameras, ReplayController(repeat(rows), clock, PAUSE_S / rate, None))


def acquisition_launcher(config: StationConfig, ring: Path, run: PrerenderedRun, rate: float, sender: Pipe) -> Launch:
    """Return a function that starts an acquisition process with the devices of `sender_devices`."""

    def launch() -> tuple[Process, Pipe]:
        spawn = multiprocessing.get_context("spawn")
        here, there = spawn.Pipe()
        # The sender attaches to the ring as its first message; the path is known only to the station.
        sender.send(str(ring))
        arguments = (config, str(ring), there, run, rate, sender)
        process = spawn.Process(target=_acquire, args=arguments, name="vaoi-acquisition", daemon=True)
        process.start()
        there.close()
        return process, here

    return launch


def _acquire(
    config: StationConfig, ring: str, connection: Pipe, run: PrerenderedRun, rate: float, sender: Pipe
) -> None:
    set_up_process(one_thread=False)
    run_acquisition(config, Path(ring), connection, partial(sender_devices, run, rate, sender))


@dataclass(frozen=True)
class BoardFigures:
    """The measured values for the run of one board."""

    state: str
    status: str
    frames: int
    lost: int
    ready_after_last_frame_ms: float
    conclude_ms: float
    links_open_at_last_frame: int
    """Links that were possible but not computed when the last frame arrived, without those of the last row."""
    lag_first_half_ms: float
    """Time from the arrival of the later of two frames to their link, median over the rows of the first half."""
    lag_second_half_ms: float
    """The same as `lag_first_half_ms` for the second half of the rows. If it is larger, the station falls behind."""


@dataclass(frozen=True)
class RateFigures:
    """Figures of all boards at one rate. Times are wall time unless the name contains `cpu`.

    A figure without any board, frame or task to compute it from is NaN, and None in the document.
    """

    rate: float
    frames_per_s: float
    mbit_per_s: float
    boards: int
    boards_missed: int
    frames_lost: int
    kept_up: bool
    """Whether the station kept up with the line.

    No board or frame was lost, and when a board's last frame arrived, at most the links of one row were not computed
    yet."""
    ready_after_last_frame_ms: dict[str, float]
    conclude_ms: float
    lag_first_half_ms: float
    lag_second_half_ms: float
    links_open_at_last_frame: float
    cpu_ms_per_frame: dict[str, float]
    """Process name → CPU time per frame. `sender` replaces cameras and network cards and is not part of the station."""
    cores: float
    """CPU time of the station's processes over the time in which boards pass, without the gaps between them."""
    sender_cores: float
    memory_mb: dict[str, float]
    """Private memory of each process after the last board; the ring is not counted."""
    statuses: dict[str, int]
    load_before: float
    each: tuple[BoardFigures, ...]

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        document: dict[str, Any] = json_document(asdict(self))
        return document


class StationUsage(NamedTuple):
    """The use of the computer while the boards passed. The keys of the mappings are names of processes."""

    load_before: float
    boards_missed: int
    cpu_s: Mapping[str, float]
    memory_mb: dict[str, float]


def measure_station_pace(
    run: PrerenderedRun, rate: float, boards: int, workers: int, folder: Path, ring: Path
) -> RateFigures:
    """Run a station with the prerendered board at a multiple of its velocity and trigger rate, and measure it.

    The files of the station stay in `folder`; `ring` is the directory of its ring.
    """
    config, load = pace_config(run, rate, workers, folder, ring), os.getloadavg()[0]
    with run_frame_sender(run) as (sender_pid, sender):
        launch = acquisition_launcher(config, ring_path(config), run, rate, sender)
        with Station(config, launch) as station:
            coordinator = station.coordinator
            # Compilation and warm-up happen once per start of the station and would count as CPU time per frame.
            _wait_until_ready(coordinator)
            pids = {"station": os.getpid(), "sender": sender_pid}
            pids |= {p.name: p.pid for p in coordinator.snapshot().processes if p.pid is not None}
            before_s = {name: cpu_s(pid) for name, pid in pids.items()}
            coordinator.arm(run.board_type.name, runs=boards)
            details = _follow(coordinator, boards)
            missed = coordinator.snapshot().boards_missed
            # This comes before the timelines are read, because their transfer is not part of the work per frame.
            cpu = {name: cpu_s(pid) - before_s[name] for name, pid in pids.items()}
            memory = {name: round(private_memory_bytes(pid) / 1e6, 1) for name, pid in pids.items()}
            each = tuple(board_figures(d, coordinator.timeline(d.id)) for d in details)
    return rate_figures(run.head, rate, each, StationUsage(load, missed, cpu, memory))


def pace_config(run: PrerenderedRun, rate: float, workers: int, folder: Path, ring: Path) -> StationConfig:
    """Return the configuration of a station with the run's array over a line that is `rate` times as fast."""
    head = run.head
    write_calibration(folder / "calibration.json", run.calibration)
    write_board_type(folder / "board-types" / f"{run.board_type.name}.json", run.board_type)
    return StationConfig(
        name=f"vaoi-bench-{os.getpid()}",
        calibration=folder / "calibration.json",
        board_types=folder / "board-types",
        data=folder / f"data-{rate:g}",
        workers=workers,
        line=_faster(run.line, rate),
        cameras=tuple(
            CameraConfig(
                name=f"camera {n}", backend="replay", width=c.width, height=c.height, exposure_us=c.exposure_us
            )
            for n, c in enumerate(head.cameras)
        ),
        controller={"backend": "replay"},
        replay=ReplayConfig(recordings=(run.directory,)),
        ring=RingConfig(directory=ring, runs=3, keep_s=0.1),
    )  # fmt: skip


def _faster(line: Line, rate: float) -> Line:
    # All times are reduced together, so that each pulse meets the board at the same place as in the prerendered run.
    return line.model_copy(
        update={
            "conveyor_mm_s": tuple(v * rate for v in line.conveyor_mm_s),
            "start_delay_s": line.start_delay_s / rate,
            "trigger_period_s": line.trigger_period_s / rate,
            "tail_s": line.tail_s / rate,
        }
    )


def _wait(coordinator: StationCoordinator, condition: Callable[[], bool], limit_s: float) -> bool:
    """Check a condition after every event; return False after the time limit."""
    deadline_s, seen = time.monotonic() + limit_s, 0
    while not condition():
        if time.monotonic() > deadline_s:
            return False
        # Workers become ready without an event, so the condition is also checked twice a second.
        records = coordinator.events(seen, 0.5)
        seen = records[-1].number if records else seen
    return True


def _wait_until_ready(coordinator: StationCoordinator) -> None:
    def ready() -> bool:
        snapshot = coordinator.snapshot()
        return snapshot.state == "idle" and not any(p.doing == "starting" for p in snapshot.processes)

    if not _wait(coordinator, ready, READY_S):
        raise StateError(f"The station was not ready within {READY_S:.0f} s: {coordinator.snapshot().reasons}.")


def _follow(coordinator: StationCoordinator, boards: int) -> list[RunDetail]:
    """Return the details of the runs in the order in which they end; fewer than `boards` if a run takes too long."""
    _wait(coordinator, lambda: coordinator.latest() is not None, RUN_LIMIT_S)
    runs, run = list[RunDetail](), coordinator.latest()
    while run is not None and len(runs) < boards:
        runs.append(run)
        run = coordinator.next_run(run.id, RUN_LIMIT_S) if len(runs) < boards else None
    if not runs:
        raise StateError(f"No run ended within {RUN_LIMIT_S:.0f} s.", action="See the log.")
    return runs


def board_figures(run: RunDetail, timeline: Timeline) -> BoardFigures:
    """Compute the figures of one run from its details and the times of its tasks."""
    last_row = run.rows - 1
    # A link of the last row becomes possible only with the last frame, so it shows nothing about a backlog.
    earlier = [t for t in timeline.tasks if max(t.row, t.other_row or 0) < last_row]
    lag = np.array([t.done_s - t.ready_s for t in timeline.tasks]) * 1e3
    late = np.array([max(t.row, t.other_row or 0) >= run.rows / 2 for t in timeline.tasks])
    timings = run.timings
    assert timings is not None
    return BoardFigures(
        state=run.state,
        status=str(run.verdict),
        frames=run.counts.ok,
        lost=run.counts.missing + run.counts.incomplete,
        ready_after_last_frame_ms=_ms(timings.ready_after_last_frame_ms),
        conclude_ms=_ms(timings.conclude_ms),
        links_open_at_last_frame=sum(t.done_s > timeline.last_frame_s for t in earlier),
        lag_first_half_ms=_median(lag[~late]),
        lag_second_half_ms=_median(lag[late]),
    )


def rate_figures(head: RecordingHead, rate: float, each: tuple[BoardFigures, ...], usage: StationUsage) -> RateFigures:
    """Combine the figures of all boards at one rate."""
    frames = sum(b.frames for b in each)
    ready = [b.ready_after_last_frame_ms for b in each]
    lost = sum(b.lost for b in each)
    per_s = rate / head.trigger_period_s
    # Each frame is linked with its predecessor and at most one neighbour.
    links_of_a_row = 2 * len(head.cameras)
    # Computed from the number of frames, because a clock would include the pauses between boards, with little load.
    passing_s = frames / (per_s * len(head.cameras))
    station_cpu_s = sum(s for name, s in usage.cpu_s.items() if name != "sender")
    return RateFigures(
        rate=rate,
        frames_per_s=round(per_s, 2),
        mbit_per_s=round(sum(c.width * c.height for c in head.cameras) * 8 * per_s * 1e-6, 1),
        boards=len(each),
        boards_missed=usage.boards_missed,
        frames_lost=lost,
        kept_up=not usage.boards_missed
        and not lost
        # Without a frame, nothing shows that the station keeps up.
        and frames > 0
        and max(b.links_open_at_last_frame for b in each) <= links_of_a_row,
        ready_after_last_frame_ms={
            "median": _median(ready),
            # The nearest rank that 99 % do not exceed: a measured value, and not one interpolated between two boards.
            "p99": sorted(ready)[math.ceil(0.99 * (len(ready) - 1))] if ready else math.nan,
            "max": max(ready, default=math.nan),
        },
        conclude_ms=_median([b.conclude_ms for b in each]),
        lag_first_half_ms=_median([b.lag_first_half_ms for b in each]),
        lag_second_half_ms=_median([b.lag_second_half_ms for b in each]),
        links_open_at_last_frame=_median([b.links_open_at_last_frame for b in each]),
        cpu_ms_per_frame={name: _quotient(s * 1e3, frames) for name, s in usage.cpu_s.items()},
        cores=_quotient(station_cpu_s, passing_s),
        sender_cores=_quotient(usage.cpu_s.get("sender", 0.0), passing_s),
        memory_mb=usage.memory_mb,
        statuses={status: sum(b.status == status for b in each) for status in sorted({b.status for b in each})},
        load_before=round(usage.load_before, 2),
        each=each,
    )


def _median(values: Iterable[float]) -> float:
    """Compute the median of the values that exist, rounded to 2 decimals; NaN if there is none."""
    # A board of one row has no lag of its second half. Infinity, for a run without a result, is included.
    known = [float(v) for v in values if not math.isnan(v)]
    return round(statistics.median(known), 2) if known else math.nan


def _quotient(part: float, whole: float) -> float:
    return round(part / whole, 3) if whole else math.nan


def _ms(value: Any) -> float:
    # A run without a result has no times. With infinity it counts as the slowest run in medians.
    return round(float(value), 2) if value is not None else float("inf")


def station_table(figures: Sequence[RateFigures]) -> str:
    """Return a table of the station's figures, with one row per rate."""
    head = (
        "rate", "frames/s", "Mbit/s", "boards", "missed", "frames lost", "kept up", "ready ms (median, p99)",
        "conclude ms", "link lag ms", "links open", "cores", "sender cores", "load",
    )  # fmt: skip
    return table(head, [_station_row(f) for f in figures])


def process_table(figures: Sequence[RateFigures]) -> str:
    """Return a table of CPU time per frame and private memory, one row per process and one column per rate."""
    names = list(figures[0].cpu_ms_per_frame) if figures else []
    head = ("process", *(f"{f.rate:g}×: CPU ms/frame, MB" for f in figures))
    return table(
        head,
        [
            (name, *(f"{number(f.cpu_ms_per_frame[name], 2)}, {f.memory_mb[name]:.0f}" for f in figures))
            for name in names
        ],
    )


def _station_row(f: RateFigures) -> tuple[object, ...]:
    ready = f.ready_after_last_frame_ms
    return (
        f"{f.rate:g}×", f"{f.frames_per_s:.2f}", f"{f.mbit_per_s:.0f}", f.boards, f.boards_missed, f.frames_lost,
        "yes" if f.kept_up else "no", f"{number(ready['median'], 0)}, {number(ready['p99'], 0)}",
        number(f.conclude_ms, 0),
        f"{number(f.lag_first_half_ms, 0)} → {number(f.lag_second_half_ms, 0)}",
        number(f.links_open_at_last_frame, 0), number(f.cores, 2), number(f.sender_cores, 2), f"{f.load_before:.1f}",
    )  # fmt: skip
