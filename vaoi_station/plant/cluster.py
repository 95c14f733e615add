"""Work on archived runs by the processes of a Dask cluster: one task per run, whatever the task is.

Dask distributes. Which workers may be used, and what becomes of a run whose worker has ended, is decided here.
"""

from __future__ import annotations

import asyncio
import hashlib
import platform
import tempfile
import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from itertools import islice
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Protocol, TypeVar

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
    """A task on one run. It is sent to a worker."""

    @property
    def archive(self) -> str:
        """Address of the archive."""

    @property
    def key(self) -> str:
        """Key of the run's manifest."""

    @property
    def manifest(self) -> str:
        """Digest of the manifest when the run was selected."""

    @property
    def software(self) -> str:
        """Software that the worker must have."""


@dataclass(frozen=True)
class RunFault:
    """A run on which no worker can perform the task."""

    message: str


@dataclass(frozen=True)
class UnseenArchive:
    """A worker that does not see the archive of a run: another one may."""

    message: str
    worker: str
    """Address of the worker; empty outside of one."""


Outcome = bytes | RunFault | UnseenArchive
"""What a worker returns: the content that the task yields, or why there is none."""


def perform(task: ArchivedTask, work: Callable[[Archive, ArchivedRun, Path], bytes]) -> Outcome:
    """Perform a task: `work` gets the archive, the run and an empty directory, which is removed afterwards.

    Raises:
        StateError: this process has another software than the task states.
        DeviceError: storage or disk do not answer. Another attempt may succeed.
    """
    if software() != task.software:
        raise StateError(f"This worker has {software()}, but must have {task.software}.")
    try:
        if task.archive not in _OPENED:
            _OPENED[task.archive] = Archive.open(task.archive)
        archive = _OPENED[task.archive]
        run = read_manifest(archive.storage, task.key)
        if run.digest != task.manifest:
            raise InputError(
                f"{archive.url}/{task.key}: was replaced after the run was selected.", action="Repeat the command."
            )
        with tempfile.TemporaryDirectory(prefix="run-", dir=_worker("local_directory")) as scratch:
            return work(archive, run, Path(scratch))
    except (InputError, NotFoundError, StateError) as error:
        # A value, not an exception: Dask would repeat the task, with the same outcome.
        return _unseen(task.archive) or RunFault(str(error))
    except DeviceError:
        _OPENED.pop(task.archive, None)
        raise


_OPENED: dict[str, Archive] = {}
"""The archives that this process has opened: to open an object store takes almost as long as to stitch a run."""


def _unseen(url: str) -> UnseenArchive | None:
    """Return whether it is the archive that this process does not see, for example because a share is not mounted."""
    try:
        Archive.open(url)
    except InputError as error:
        _OPENED.pop(url, None)
        return UnseenArchive(str(error), _worker("address") or "")
    return None


def _worker(name: str) -> str | None:
    """Return the address or the directory of this worker; Dask removes the directory also after a kill.

    Outside of a worker there is neither.
    """
    with suppress(ImportError, ValueError):
        from distributed import get_worker

        return str(getattr(get_worker(), name))
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
"""Settings of Dask for the workers of this machine."""
EXTRA = "Install the extra: pip install 'vaoi-station[plant]'."


@dataclass(frozen=True)
class ClusterOptions:
    """Where the work is done: by a number of processes of this machine, or by the workers of a scheduler."""

    scheduler: str | None = None
    workers: int | None = None
    memory_mb: int = 2000
    """Limit of one local worker; a scheduler's workers have theirs."""
    dashboard: str | None = None
    """Address of the local cluster's dashboard, such as 127.0.0.1:8787; None: any free port of loopback."""
    patience_s: float = 30.0
    """Longest wait for the scheduler, and for a usable worker."""

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
    """Yield a client of a scheduler.

    Raises:
        StateError: the scheduler does not answer in time.
    """
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
    """Return the address of a scheduler's dashboard; None if it serves none.

    Raises:
        StateError: the scheduler does not answer in time.
    """
    from distributed.comm.addressing import get_address_host

    port = _identity(address, patience_s).get("services", {}).get("dashboard")
    return f"http://{get_address_host(address)}:{port}/status" if port else None


def _identity(address: str, patience_s: float) -> dict[str, Any]:
    """Return what a scheduler states of itself; StateError if none answers in time."""
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


_AT_ONCE_S = 2.0
"""Time in which most workers reply. The others are not waited for: their replies count when they come."""
SILENCE_S = 60.0
"""Silence after which a worker is named. A new worker first imports the software."""


class Reply(NamedTuple):
    """What a worker replies when it is asked."""

    software: str
    unseen: str = ""
    """Why it cannot read an archive; empty: it reads all of them."""


class _Question(NamedTuple):
    """A question to a worker."""

    address: str
    directory: str
    """Local directory of the worker. No two processes have the same."""
    asked_s: float


class Crew:
    """The workers that may be used. Each other one is reported once, and not used.

    A worker is admitted by an abstract resource, which every task needs. So Dask itself gives tasks to admitted workers
    only, one at a time, and to those that join or come back as soon as they are admitted. One that does not see an
    archive is asked again and again: its share may be mounted later.
    """

    def __init__(self, client: Client, stated: str, archives: Iterable[str], report: Callable[[str], None]) -> None:
        self._client, self._stated, self._archives, self._report = client, stated, tuple(archives), report
        self._judged: dict[str, str] = {}
        """Local directory of each worker that was admitted or has other software, by address."""
        self._asked: dict[str, _Question] = {}
        """Questions that are under way, by address."""
        self._replies: SimpleQueue[tuple[_Question, Any]] = SimpleQueue()
        self.admitted: set[str] = set()
        """Addresses of the workers that are there and may be used."""
        self._refused: dict[str, str] = {}
        """Why each other worker is not used, by its address."""

    @property
    def refused(self) -> list[str]:
        """Why each other worker is not used."""
        return list(self._refused.values())

    @property
    def resource(self) -> str:
        """Name of the resource."""
        return f"vaoi-{hashlib.sha256(self._stated.encode()).hexdigest()[:16]}"

    def update(self) -> None:
        """Find out which workers are there, ask the new ones, and admit or refuse those that have replied."""
        workers = self._client.scheduler_info()["workers"]
        present = {address: str(worker["local_directory"]) for address, worker in workers.items()}
        # A worker that is started again under its address has no resource, and maybe other software.
        self._judged = {address: known for address, known in self._judged.items() if present.get(address) == known}
        self.admitted &= self._judged.keys()
        self._asked = {address: q for address, q in self._asked.items() if present.get(address) == q.directory}
        now_s = time.monotonic()
        new = [
            _Question(address, directory, now_s)
            for address, directory in sorted(present.items())
            if address not in self._judged and address not in self._asked
        ]
        for question in new:
            self._asked[question.address] = question
            # A worker that hangs never replies: a daemon thread is left behind then.
            threading.Thread(target=self._ask, args=(question,), name="vaoi-crew", daemon=True).start()
        end_s = now_s + _AT_ONCE_S if new else now_s
        while any(question is self._asked.get(question.address) for question in new) and time.monotonic() < end_s:
            self._receive(max(end_s - time.monotonic(), 0.0))
        while self._receive(0.0):
            pass
        for address, question in self._asked.items():
            if time.monotonic() - question.asked_s > SILENCE_S:
                self._refuse(address, f"it has not replied for {SILENCE_S:g} s")

    def doubt(self, address: str) -> None:
        """Ask a worker again, which could not read an archive; it gets no task meanwhile."""
        self._judged.pop(address, None)
        self.admitted.discard(address)

    def _ask(self, question: _Question) -> None:
        address, reply = question.address, None
        try:
            reply = self._client.run(
                _admit, self._stated, self.resource, self._archives, workers=[address], on_error="return"
            ).get(address)
        except Exception as error:  # noqa: BLE001  the connection ends with the client
            reply = error if isinstance(error, OSError) else OSError(str(error))
        self._replies.put((question, reply))

    def _receive(self, wait_s: float) -> bool:
        """Judge the worker of the next reply; return whether there was one."""
        try:
            question, reply = self._replies.get(timeout=wait_s) if wait_s else self._replies.get_nowait()
        except Empty:
            return False
        address = question.address
        if self._asked.get(address) is not question:
            return True  # Another process has this address meanwhile.
        del self._asked[address]
        if isinstance(reply, OSError) or reply is None:
            return True  # It has just gone; if not, the next call tries it again.
        if isinstance(reply, Reply) and reply.software == self._stated and reply.unseen:
            self._refuse(address, f"it cannot read an archive: {reply.unseen}")
            return True
        self._judged[address] = question.directory
        if isinstance(reply, Reply) and reply.software == self._stated:
            self.admitted.add(address)
            self._refused.pop(address, None)
        else:
            # A worker without this package, or with one too old for this question, replies with an exception.
            has = getattr(reply, "software", None) or f"no usable software ({type(reply).__name__}: {reply})"
            self._refuse(address, f"it has {has}, but must have {self._stated}.")
        return True

    def _refuse(self, address: str, why: str) -> None:
        line = f"worker {address} is not used: {why}"
        if self._refused.get(address) != line:
            self._refused[address] = line
            self._report(line)


async def _admit(stated: str, name: str, archives: tuple[str, ...], dask_worker: Any) -> Reply:
    """Run on a worker: give it the resource if it has the stated software and reads the archives; return both."""
    if (own := software()) != stated:
        return Reply(own)
    try:
        for url in archives:
            await asyncio.to_thread(Archive.open, url)
    except VaoiError as error:
        await dask_worker.set_resources(**{name: 0})
        return Reply(own, str(error))
    await dask_worker.set_resources(**{name: 1})
    return Reply(own)


_T = TypeVar("_T")
_Task = TypeVar("_Task", bound=ArchivedTask)

AHEAD = 2
"""Number of runs per worker that the scheduler knows: one in work, one that follows without a pause."""
RETRIES = 2
"""Number of further attempts at a run whose storage did not answer."""
MOST_UNSEEN = 8
"""Number of attempts at a run whose workers do not see its archive."""
_LOOK_S = 1.0
"""Pause between two searches for workers that have joined or come back."""
_REPLY_S = 60.0
"""Longest wait for a reply of the scheduler."""
_RECEIPT_S = 5.0, 60.0
"""First and longest wait for an outcome that a worker has: the worker may have ended before it was fetched."""


class _SchedulerLostError(Exception):
    """The connection to the scheduler has ended."""


class Dispatch(Generic[_Task]):
    """The work on a list of runs, also if workers or the scheduler are replaced meanwhile."""

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
        self.refused_workers: list[str] = []
        self._more: Iterator[_Task] = iter(())
        self._waiting: deque[_Task] = deque()
        """Runs that were taken from `_more` and that no worker has."""
        self._outcomes = 0
        """Number of runs that were kept or left out."""
        self._unseen: Counter[tuple[str, str]] = Counter()
        """How often a worker did not see the archive of a run."""

    def work(
        self,
        address: str,
        tasks: Iterable[_Task],
        archives: Iterable[str],
        patience_s: float,
        workers_patience_s: float | None = None,
    ) -> None:
        """Work on all tasks. A scheduler that has ended is waited for, and given what is not done.

        Args:
            address: that of the scheduler.
            tasks: the runs. The next one is taken when a worker is to have it.
            archives: what the workers must see.
            patience_s: longest wait for the scheduler.
            workers_patience_s: longest wait for a usable worker; None: as long as for the scheduler.

        Raises:
            StateError: the scheduler, or any usable worker, is absent for too long.
        """
        self._more, archives = iter(tasks), tuple(archives)
        before = -1
        while self._next():
            try:
                with connection(address, patience_s) as client:
                    crew = Crew(client, self._software, archives, self._report)
                    try:
                        self._work(client, crew, patience_s if workers_patience_s is None else workers_patience_s)
                    finally:
                        self.refused_workers += (line for line in crew.refused if line not in self.refused_workers)
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

    def _work(self, client: Client, crew: Crew, patience_s: float) -> None:
        finished: SimpleQueue[Any] = SimpleQueue()
        given: dict[Any, _Task] = {}
        late: Counter[Any] = Counter()
        unassigned: set[Any] = set()
        looked_s, seen_s = 0.0, time.monotonic()
        try:
            while given or self._next():
                now_s = time.monotonic()
                if client.status != "running":
                    raise _SchedulerLostError
                if now_s - looked_s >= _LOOK_S:
                    looked_s = now_s
                    _in_time(crew.update)
                    found = _in_time(lambda: _unassigned(client, given, crew.admitted))
                    self._take_back(client, given, found & unassigned)
                    unassigned = found
                seen_s = now_s if crew.admitted else seen_s
                if now_s - seen_s > patience_s:
                    raise _without_workers(crew, patience_s)
                while len(given) < AHEAD * len(crew.admitted) and self._next():
                    task = self._waiting.popleft()
                    future = _submit(client, self._perform, task, crew.resource)
                    given[future] = task
                    future.add_done_callback(finished.put)
                try:
                    future = finished.get(timeout=_LOOK_S / 4)
                except Empty:
                    continue
                if future in given and not self._receive(future, given, crew, late):
                    future.add_done_callback(finished.put)
        finally:
            # Also after Ctrl-C: what was given and not received is done again, by this call or the next.
            self._waiting.extendleft(reversed(given.values()))
            if given and client.status == "running":
                client.cancel(list(given), force=True)

    def _take_back(self, client: Client, given: dict[Any, _Task], futures: set[Any]) -> None:
        """Take back runs that no worker has, so that they are given anew."""
        if futures:
            self._waiting.extendleft([given.pop(future) for future in futures])
            client.cancel(list(futures), force=True)

    def _receive(self, future: Any, given: dict[Any, _Task], crew: Crew, late: Counter[Any]) -> bool:
        """Keep the outcome of a run, or leave the run out; return False if the outcome cannot be fetched yet."""
        try:
            outcome = self._outcome(future, given[future], min(_RECEIPT_S[0] * 2 ** late[future], _RECEIPT_S[1]))
        except TimeoutError:
            # Its worker has ended before the outcome was fetched: Dask repeats the run as soon as there is an
            # admitted worker. Or the network is slow.
            late[future] += 1
            return False
        task = given.pop(future)
        future.release()
        if isinstance(outcome, UnseenArchive):
            crew.doubt(outcome.worker)
            _in_time(crew.update)
            self._again(task, outcome)
        elif isinstance(outcome, RunFault):
            self._outcomes += 1
            self._leave_out(task, outcome.message)
        else:
            self._outcomes += 1
            self._keep(task, outcome)
        return True

    def _again(self, task: _Task, outcome: UnseenArchive) -> None:
        """Give a run to another worker, unless too many have not seen its archive."""
        self._unseen[task.archive, task.key] += 1
        if self._unseen[task.archive, task.key] < MOST_UNSEEN:
            self._waiting.appendleft(task)
        else:
            self._outcomes += 1
            self._leave_out(task, outcome.message)

    @staticmethod
    def _outcome(future: Any, task: _Task, wait_s: float) -> Outcome:
        """Return the outcome of a run; TimeoutError if it cannot be fetched in time."""
        from distributed.comm.core import CommClosedError

        try:
            outcome: Outcome = future.result(timeout=wait_s)
        except VaoiError as error:  # of a storage or disk, after the last attempt
            return RunFault(str(error))
        except Exception as error:
            if isinstance(error, TimeoutError) and future.status != "error":
                raise
            # Dask has lost the connection, or has given a run up; any other exception is a fault of the software.
            if future.status in {"lost", "cancelled"} or isinstance(error, CommClosedError):
                raise _SchedulerLostError from error
            text = str(error).partition("\n")[0]
            return RunFault(f"{task.archive}/{task.key}: {type(error).__name__}: {text}")
        return outcome


def _submit(client: Client, perform: Callable[[_Task], Outcome], task: _Task, resource: str) -> Any:
    # A key of its own: the key of another call for the same run would give that call's outcome.
    key = f"{perform.__name__}-{uuid.uuid4().hex}"
    return client.submit(perform, task, key=key, resources={resource: 1}, retries=RETRIES, pure=False)


def _unassigned(client: Client, given: dict[Any, _Task], admitted: Collection[str]) -> set[Any]:
    """Return the runs that are not done and that no admitted worker has.

    When the last worker of a resource ends, Dask keeps its tasks; and it gives them to no worker that gets the resource
    after it has joined. A worker that loses the resource keeps the tasks that it has not begun, and never begins them.
    """
    if not given:
        return set()
    assigned = {key for address, keys in client.processing().items() if address in admitted for key in keys}
    return {future for future in given if future.status in {"pending", "lost"} and future.key not in assigned}


def _in_time(call: Callable[[], _T]) -> _T:
    """Return what a call returns that asks the scheduler. One that does not reply in time counts as gone."""
    results: list[_T] = []
    failures: list[Exception] = []

    def perform() -> None:
        try:
            results.append(call())
        except Exception as error:  # noqa: BLE001  (raised again below, in the thread that waits)
            failures.append(error)

    # Dask's calls have no bound where a scheduler hangs; a daemon thread is left behind then.
    thread = threading.Thread(target=perform, name="vaoi-dispatch", daemon=True)
    thread.start()
    thread.join(_REPLY_S)
    if failures and not isinstance(failures[0], OSError | TimeoutError):
        raise failures[0]
    if not results:
        raise _SchedulerLostError from (failures[0] if failures else None)
    return results[0]


def _without_workers(crew: Crew, patience_s: float) -> StateError:
    others = " ".join(crew.refused) or "No worker has joined."
    return StateError(
        f"No usable worker for {patience_s:g} s; runs are left. {others}",
        action="Start workers with the stated software (`dask worker ADDRESS`), then repeat the command: what is done "
        "stays done.",
        code="no-worker",
    )
