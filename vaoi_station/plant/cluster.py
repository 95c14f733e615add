"""Work on archived runs by the processes of a Dask cluster: one task per run, whatever the task is.

Dask distributes. Which workers may be used, and what becomes of a run whose worker has ended, is decided here.
"""

from __future__ import annotations

import asyncio
import hashlib
import platform
import tempfile
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from functools import cache
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.catalogue import read_manifest
from vaoi_station.plant.manifest import ArchivedRun
from vaoi_station.version import __version__

if TYPE_CHECKING:
    from distributed import Client


@cache
def software() -> str:
    """Return version and digest of the package's sources, and the versions on which the last digits depend."""
    import cv2
    import numba
    import numpy as np

    # The version alone does not say which commit a worker runs.
    digest = hashlib.sha256()
    root = Path(__file__).parents[2]  # that of the package
    for path in sorted(root.rglob("*.py")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    python = ".".join(platform.python_version_tuple()[:2])
    return (
        f"vaoi_station {__version__} (sources {digest.hexdigest()[:12]}, Python {python}, numpy {np.__version__}, "
        f"numba {numba.__version__}, opencv {cv2.__version__})"
    )


class ArchivedTask(Protocol):
    """A task on one run: address of its archive, key and digest of its manifest, and the software that it needs."""

    @property
    def archive(self) -> str: ...  # noqa: D102
    @property
    def key(self) -> str: ...  # noqa: D102
    @property
    def manifest(self) -> str: ...  # noqa: D102
    @property
    def software(self) -> str: ...  # noqa: D102


@dataclass(frozen=True)
class RunFault:
    """Why no worker can perform a task."""

    message: str


@dataclass(frozen=True)
class WorkerFault:
    """Why this worker cannot perform a task: another one may."""

    message: str


Outcome = bytes | RunFault | WorkerFault


def perform(task: ArchivedTask, work: Callable[[Archive, ArchivedRun, Path], bytes]) -> Outcome:
    """Perform a task: `work` gets the archive, the run and an empty directory, which is removed afterwards.

    DeviceError says that storage or disk do not answer: another attempt may succeed.
    """
    if unfit := _unfit(task.software):
        return WorkerFault(unfit)
    try:
        if task.archive not in _OPENED:
            _OPENED[task.archive] = Archive.open(task.archive)
        archive = _OPENED[task.archive]
        run = read_manifest(archive.storage, task.key)
        if run.digest != task.manifest:
            raise InputError(
                f"{archive.url}/{task.key}: was replaced after the run was selected.", action="Repeat the command."
            )
        with tempfile.TemporaryDirectory(prefix="run-", dir=_scratch()) as scratch:
            return work(archive, run, Path(scratch))
    except (InputError, NotFoundError, StateError) as error:
        # A value, not an exception: Dask would repeat the task, with the same outcome.
        if unfit := _unfit(task.software, (task.archive,)):
            _OPENED.pop(task.archive, None)
            return WorkerFault(unfit)
        return RunFault(str(error))
    except DeviceError:
        _OPENED.pop(task.archive, None)
        raise


_OPENED: dict[str, Archive] = {}
"""The archives that this process has opened: to open an object store takes almost as long as to stitch a run."""


def _unfit(stated: str, archives: Iterable[str] = ()) -> str:
    """Return why this process cannot work on the runs of some archives; empty: it can."""
    if (own := software()) != stated:
        return f"it has {own}, but must have {stated}."
    try:
        for url in archives:
            Archive.open(url)
    except VaoiError as error:  # for example because a share is not mounted
        return f"it cannot read an archive: {error}"
    return ""


def _scratch() -> str | None:
    """Return the directory of this worker, which Dask removes also after a kill; None outside of a worker."""
    with suppress(ImportError, ValueError):
        from distributed import get_worker

        return str(get_worker().local_directory)
    return None


MOST_WORKERS = 256
_ANY_PORT = "127.0.0.1:0"
_WORKERS: dict[str, Any] = {
    # Dask has the allocator return freed memory at once (docs.dask.org, "Worker Memory Management"). glibc then maps
    # and clears the pages of every picture anew (mallopt(3), M_TRIM_THRESHOLD): a quarter of the time of a run.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
    # It samples the stacks of the worker 100 times a second; what a run costs is in its outcome.
    "distributed.worker.profile.enabled": False,
    # By default the event loops of workers, nannies and scheduler each wake up 50 times a second to measure their own
    # delay, 10 times to read the memory of a worker, and twice to read the load of the machine. With two workers that
    # takes a tenth of a processor, from the runs that use all of them.
    "distributed.admin.tick.interval": "1s",
    "distributed.worker.memory.monitor-interval": "500ms",
    "distributed.admin.system-monitor.interval": "2s",
    # Dask gives a worker up whose successor is not there 15 s after its end: also one that has just been killed again,
    # or that takes longer to start on a busy machine. The nanny's own wait for the successor is the bound that counts.
    "distributed.deploy.lost-worker-timeout": "10 days",
}
EXTRA = "Install the extra: pip install 'vaoi-station[plant]'."


@dataclass(frozen=True)
class ClusterOptions:
    """Where the work is done: by a number of processes of this machine, or by the workers of a scheduler."""

    scheduler: str | None = None
    workers: int | None = None
    memory_mb: int = 2000
    dashboard: str | None = None
    """Address of the local cluster's dashboard, such as 127.0.0.1:8787; None: any free port of loopback."""
    patience_s: float = 30.0

    def check(self) -> None:
        """Raise InputError unless exactly one of scheduler and workers is given, within its limits."""
        if (self.scheduler is None) == (self.workers is None):
            raise InputError(
                "The cluster: --scheduler and --workers exclude each other, and one of them is needed.",
                action="Give --workers N for processes of this machine, or --scheduler tcp://HOST:8786.",
            )
        if self.workers is not None and not 1 <= self.workers <= MOST_WORKERS:
            raise InputError.field("the cluster", "--workers", self.workers, f"from 1 to {MOST_WORKERS}")
        if self.scheduler is not None and "://" not in self.scheduler:
            raise InputError.field(
                "the cluster", "--scheduler", self.scheduler, "an address such as tcp://10.0.0.5:8786"
            )


@contextmanager
def cluster_address(options: ClusterOptions) -> Iterator[str]:
    """Yield the address of the scheduler. A local cluster lives as long as this context."""
    try:
        import dask
        from distributed import LocalCluster
    except ImportError as error:
        raise InputError(f"{error.name or 'distributed'}: is not installed.", action=EXTRA) from error
    options.check()
    if options.scheduler is not None:
        yield options.scheduler
        return
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(_WORKERS))
        # One task at a time in each process: the memory of a worker is that of one run. TCP on loopback, as between
        # machines; the nanny of each worker starts it again after a kill.
        local = LocalCluster(
            n_workers=options.workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            protocol="tcp://",
            memory_limit=f"{options.memory_mb}MB",
            # Without an address Dask's pages would be served on port 8787 of all interfaces, or fail if that is taken.
            dashboard_address=options.dashboard or _ANY_PORT,
            worker_dashboard_address=_ANY_PORT,
            preload=["vaoi_station.plant.worker_setup"],
            silence_logs=40,  # errors only: the outcome of every run is reported here
        )
        stack.enter_context(local)
        yield str(local.scheduler_address)


@contextmanager
def connection(address: str, patience_s: float) -> Iterator[Client]:
    """Yield a client of a scheduler; StateError if it does not answer in time."""
    from distributed import Client

    try:
        _identity(address, patience_s)
        client = Client(address, timeout=patience_s, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise _no_answer(address, patience_s, error) from error
    try:
        yield client
    finally:
        client.close(timeout=2)


def dashboard_link(address: str, patience_s: float) -> str | None:
    """Return the address of a scheduler's dashboard; None if it serves none."""
    from distributed.comm.addressing import get_address_host

    port = _identity(address, patience_s).get("services", {}).get("dashboard")
    return f"http://{get_address_host(address)}:{port}/status" if port else None


def _identity(address: str, patience_s: float) -> dict[str, Any]:
    try:
        # Dask's own wait is not bounded where a port accepts connections and never replies.
        return asyncio.run(asyncio.wait_for(_greet(address), patience_s))
    except (OSError, TimeoutError, ValueError) as error:  # ValueError: an unknown protocol
        raise _no_answer(address, patience_s, error) from error


def _no_answer(address: str, patience_s: float, error: Exception) -> StateError:
    return StateError(
        f"{address}: no scheduler answers within {patience_s:g} s ({type(error).__name__}).",
        action="Check address and firewall, start it with `dask scheduler`, then repeat the command: what is done "
        "stays done.",
        code="scheduler-absent",
    )


async def _greet(address: str) -> dict[str, Any]:
    """Connect to a scheduler until it replies; a wait for it is bounded by the caller."""
    from distributed.comm.core import connect
    from distributed.core import send_recv

    comm = await connect(address, timeout="1 day")
    try:
        known = await send_recv(comm, op="identity", reply=True)
    finally:
        comm.abort()
    if known.get("type") != "Scheduler":
        raise ValueError(f"{address} is a {known.get('type')}")
    return dict(known)


_Task = TypeVar("_Task", bound=ArchivedTask)

AHEAD = 2
RETRIES = 2
MOST_WORKER_FAULTS = 4
"""Number of attempts at a run whose workers end, or do not see its archive."""
SILENCE_S = 60.0
"""Silence after which a worker is named. A new worker first imports the software."""
_LOOK_S = 1.0
_REPLY_S = 60.0
"""Longest wait for a reply of the scheduler, and for an outcome that a worker has."""
_FIRST_RECEIPT_S = 5.0
"""First wait for an outcome: its worker may have ended before it was fetched. Each further one is twice as long."""


class _SchedulerLostError(Exception):
    """The connection to the scheduler has ended."""


@dataclass
class _Worker(Generic[_Task]):
    """A worker process. It gets no run before it has replied that it is fit."""

    process: str
    """Its local directory: no two processes have the same, also if they have the same address."""
    most: int
    fit: bool = False
    question: Any = None
    asked_s: float = 0.0
    given: dict[Any, _Task] = field(default_factory=dict)
    """Its runs by their futures, in the order in which it works on them."""


class Dispatch(Generic[_Task]):
    """The work on a list of runs, also if workers or the scheduler are replaced meanwhile.

    Each run is given to a certain worker, so that it is known here which runs a worker had that has gone: in whatever
    state Dask keeps them, they are given anew. A worker that is not fit is reported once, and asked again and again:
    its share may be mounted later.
    """

    def __init__(
        self,
        software: str,
        perform: Callable[[_Task], Outcome],
        keep: Callable[[_Task, bytes], None],
        leave_out: Callable[[_Task, str], None],
        report: Callable[[str], None],
    ) -> None:
        self._software, self._perform = software, perform
        self._keep, self._leave_out, self._report = keep, leave_out, report
        self._refused: dict[str, str] = {}
        self._more: Iterator[_Task] = iter(())
        self._waiting: deque[_Task] = deque()
        """Runs that were taken from `_more` and that no worker has."""
        self._outcomes = 0
        self._worker_faults: Counter[tuple[str, str]] = Counter()
        self._receipt_s = _FIRST_RECEIPT_S
        self._client: Any = None
        self._workers: dict[str, _Worker[_Task]] = {}
        self._finished: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    @property
    def refused_workers(self) -> list[str]:
        """Why each other worker was not used."""
        return list(self._refused.values())

    def work(
        self,
        address: str,
        tasks: Iterable[_Task],
        archives: Iterable[str],
        patience_s: float,
        workers_patience_s: float | None = None,
    ) -> None:
        """Work on all tasks; the next one is taken when a worker is to have it.

        A scheduler that has ended is waited for, and given what is not done. StateError if it, or any usable worker, is
        absent for longer than the patience.
        """
        self._more, archives = iter(tasks), tuple(archives)
        before = -1
        while self._next():
            try:
                with connection(address, patience_s) as client:
                    self._work(client, archives, patience_s if workers_patience_s is None else workers_patience_s)
            except _SchedulerLostError as error:
                # One that is lost again and again without any outcome would be tried for ever.
                if self._outcomes == before:
                    raise StateError(
                        f"{address}: the scheduler was lost twice without the outcome of a run.",
                        action="Check its log and the network, then repeat the command: what is done stays done.",
                        code="scheduler-absent",
                    ) from error
                before = self._outcomes
                self._report(f"{address}: the scheduler has gone; what is not done is given to the next.")

    def _next(self) -> bool:
        """Return whether a run waits, after taking the next one if none does."""
        if not self._waiting:
            self._waiting.extend(islice(self._more, 1))
        return bool(self._waiting)

    def _work(self, client: Client, archives: tuple[str, ...], patience_s: float) -> None:
        self._client, self._workers, self._finished = client, {}, SimpleQueue()
        looked_s, seen_s = 0.0, time.monotonic()
        try:
            while any(worker.given for worker in self._workers.values()) or self._next():
                now_s = time.monotonic()
                if client.status != "running":
                    raise _SchedulerLostError
                if now_s - looked_s >= _LOOK_S:
                    looked_s = now_s
                    self._look()
                    self._ask(archives)
                fit = {address: worker for address, worker in self._workers.items() if worker.fit}
                seen_s = now_s if fit else seen_s
                if now_s - seen_s > patience_s:
                    raise self._without_workers(patience_s)
                for address, worker in fit.items():
                    while self._takes_more(worker):
                        task = self._waiting.popleft()
                        worker.given[self._submit(address, self._perform, task, retries=RETRIES)] = task
                with suppress(Empty):
                    self._receive(*self._finished.get(timeout=_LOOK_S / 4))
        finally:
            # Also after Ctrl-C: what was given and not received is done again, by this call or the next.
            for worker in self._workers.values():
                self._take_back(worker)

    def _takes_more(self, worker: _Worker[_Task]) -> bool:
        """Return whether a worker is to have the next run; one whose worker has ended is alone, so that it shows."""
        if not self._next():
            return False
        tasks = (*worker.given.values(), self._waiting[0])
        suspected = any((task.archive, task.key) in self._worker_faults for task in tasks)
        return len(worker.given) < (1 if suspected else worker.most)

    def _submit(self, address: str, function: Callable[..., Any], *inputs: object, **options: int) -> Any:
        # A key of its own: the key of another call for the same run would give that call's outcome.
        key = f"{function.__name__}-{uuid.uuid4().hex}"
        future = self._client.submit(function, *inputs, key=key, workers=[address], pure=False, **options)
        self._expect(address, future)
        return future

    def _expect(self, address: str, future: Any) -> None:
        finished = self._finished
        future.add_done_callback(lambda done: finished.put((address, done)))

    def _ask(self, archives: tuple[str, ...]) -> None:
        now_s = time.monotonic()
        for address, worker in self._workers.items():
            if worker.fit:
                continue
            if worker.question is None:
                worker.asked_s = now_s
                worker.question = self._submit(address, _unfit, self._software, archives, priority=1)
            elif now_s - worker.asked_s > SILENCE_S:
                self._refuse(address, f"it has not replied for {SILENCE_S:g} s")

    def _look(self) -> None:
        try:
            # Without this bound the call does not return where a scheduler hangs.
            found = self._client.sync(self._client.scheduler.identity, callback_timeout=_REPLY_S)["workers"]
        except (OSError, TimeoutError) as error:
            raise _SchedulerLostError from error
        for address, worker in list(self._workers.items()):
            if address not in found or worker.process != found[address]["local_directory"]:
                del self._workers[address]
                if worker.given:
                    first = next(iter(worker.given))
                    task = worker.given.pop(first)
                    first.release()
                    self._again(task, f"{task.archive}/{task.key}: its worker ended {MOST_WORKER_FAULTS} times.")
                self._take_back(worker)
        for address, facts in sorted(found.items()):
            # One run at a time, also in a worker of several threads: its memory is that of one run.
            most = AHEAD if facts["nthreads"] == 1 else 1
            self._workers.setdefault(address, _Worker(facts["local_directory"], most))

    def _judge(self, address: str, worker: _Worker[_Task]) -> None:
        try:
            unfit = worker.question.result(timeout=_REPLY_S)
        except Exception as error:  # noqa: BLE001  of a worker without this package, or with one too old for the question
            unfit = None  # It has just gone; if not, it is asked again.
            if worker.question.status == "error" and not isinstance(error, OSError):
                unfit = f"it has no usable software ({type(error).__name__}: {error}), but must have {self._software}."
        worker.question.release()
        worker.question, worker.fit = None, unfit == ""
        if worker.fit:
            self._refused.pop(address, None)
        elif unfit:
            self._refuse(address, unfit)

    def _refuse(self, address: str, why: str) -> None:
        line = f"worker {address} is not used: {why}"
        if self._refused.get(address) != line:
            self._refused[address] = line
            self._report(line)

    def _take_back(self, worker: _Worker[_Task]) -> None:
        self._waiting.extendleft(reversed(worker.given.values()))
        for future in worker.given:
            future.release()
        worker.given.clear()

    def _receive(self, address: str, future: Any) -> None:
        """Take the reply of a worker, or the outcome of a run; others are of workers that have gone."""
        worker = self._workers.get(address)
        if worker is not None and future is worker.question:
            self._judge(address, worker)
        if worker is None or future not in worker.given:
            return
        try:
            outcome = self._outcome(future, worker.given[future])
        except TimeoutError:
            # Its worker has ended before the outcome was fetched. Or the network is slow.
            self._receipt_s = min(2 * self._receipt_s, _REPLY_S)
            self._expect(address, future)
            return
        task = worker.given.pop(future)
        future.release()
        if isinstance(outcome, WorkerFault):
            worker.fit = False
            self._refuse(address, outcome.message)
            self._take_back(worker)
            self._again(task, f"{task.archive}/{task.key}: {outcome.message}")
        elif isinstance(outcome, RunFault):
            self._outcomes += 1
            self._leave_out(task, outcome.message)
        else:
            self._outcomes += 1
            self._keep(task, outcome)

    def _again(self, task: _Task, why: str) -> None:
        self._worker_faults[task.archive, task.key] += 1
        if self._worker_faults[task.archive, task.key] < MOST_WORKER_FAULTS:
            self._waiting.appendleft(task)
        else:
            self._outcomes += 1
            self._leave_out(task, why)

    def _outcome(self, future: Any, task: _Task) -> Outcome:
        """Return the outcome of a run; TimeoutError if it cannot be fetched in time."""
        from distributed.comm.core import CommClosedError

        try:
            outcome: Outcome = future.result(timeout=self._receipt_s)
        except VaoiError as error:  # of a storage or disk, after the last attempt
            return RunFault(str(error))
        except Exception as error:
            if isinstance(error, TimeoutError) and future.status != "error":
                raise
            # Dask has lost the connection, or has given a run up; any other exception is a fault of the software.
            if future.status != "error" or isinstance(error, CommClosedError):
                raise _SchedulerLostError from error
            text = str(error).partition("\n")[0]
            return RunFault(f"{task.archive}/{task.key}: {type(error).__name__}: {text}")
        return outcome

    def _without_workers(self, patience_s: float) -> StateError:
        others = " ".join(self.refused_workers) or "No worker has joined."
        return StateError(
            f"No usable worker for {patience_s:g} s; runs are left. {others}",
            action="Start workers with the stated software (`dask worker ADDRESS`), then repeat the command: what is "
            "done stays done.",
            code="no-worker",
        )
