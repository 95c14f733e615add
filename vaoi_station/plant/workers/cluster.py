"""The cluster: one on this machine, or a scheduler somewhere."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from vaoi_station.errors import InputError, StateError

if TYPE_CHECKING:
    from distributed import Client

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
            preload=["vaoi_station.plant.workers.worker_setup"],
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
