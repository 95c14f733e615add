"""Gives the runs to Dask, a bounded number at a time, and receives what becomes of them."""

from __future__ import annotations

import threading
import time
import uuid
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable, Iterator
from itertools import islice
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from vaoi_station.errors import StateError, VaoiError
from vaoi_station.plant.workers.cluster import connection
from vaoi_station.plant.workers.crew import Crew
from vaoi_station.plant.workers.run_work import ArchivedTask, Outcome, RunFault, UnseenArchive

if TYPE_CHECKING:
    from distributed import Client

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
