"""Which workers of a cluster may be used: those that have the stated software, and see the archives."""

from __future__ import annotations

import asyncio
import hashlib
import threading
import time
from collections.abc import Callable, Iterable
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from vaoi_station.errors import VaoiError
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.workers.software import software

if TYPE_CHECKING:
    from distributed import Client

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
