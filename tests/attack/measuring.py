"""What an honest caller notices of an attack: times of its requests, boards missed, memory of the station."""

from __future__ import annotations

import re
import threading
import time
import urllib.request
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

from tests.attack.attacks import Attack, Target
from vaoi_station.demo.client import Client
from vaoi_station.errors import VaoiError

_MEMORY = re.compile(r'^vaoi_process_(resident|shared)_bytes\{process="station"\} (\S+)$', re.MULTILINE)
THREADS = 2
"""Threads of an attack."""


@dataclass
class Experience:
    """What the honest caller measured while something went on."""

    waits_s: list[float] = field(default_factory=list)
    """Times of its requests for the matrices of the last run."""
    refused: list[str] = field(default_factory=list)
    """Requests of it that failed."""
    memory_bytes: float = 0.0
    """Largest memory of the station process, without the shared part."""
    runs: dict[str, str] = field(default_factory=dict)
    """Verdict of each run that was seen."""
    late_ms: float = 0.0
    """Longest time from a last frame to its result."""
    missed: int = 0
    """Boards that passed without a run."""
    busy: list[float] = field(default_factory=list)
    """Shares of a processor that the station process and the attacker used, as far as they were measured."""

    def quantile_s(self, share: float) -> float:
        """Return the time within which a share of the requests was answered."""
        ordered = sorted(self.waits_s)
        return ordered[min(len(ordered) - 1, int(share * len(ordered)))] if ordered else float("inf")


@contextmanager
def attacked(target: Target, attack: Attack | None) -> Iterator[None]:
    """Run an attack in threads while the context is entered."""
    stop = threading.Event()
    threads = [threading.Thread(target=attack, args=(target, stop)) for _ in range(THREADS)] if attack else []
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def experience(client: Client, seconds: float, pause_s: float = 0.1, station: str = "") -> Experience:
    """Ask for the last run, its matrices and the metrics for a time; every request has a connection of its own.

    `station` is the address for the metrics if the client asks a proxy.
    """
    noted, missed = Experience(), client.get("/station")["boards_missed"]
    # The time begins here: on a busy computer the first request may take longer than all of it.
    waiting, end = threading.Event(), time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            run = client.get("/runs/latest")
            begun = time.monotonic()
            client.content(f"/runs/{run['id']}/matrices")
            noted.waits_s.append(time.monotonic() - begun)
            noted.runs[run["id"]] = run["verdict"]
            noted.late_ms = max(noted.late_ms, (run.get("timings") or {}).get("ready_after_last_frame_ms", 0.0))
            noted.memory_bytes = max(noted.memory_bytes, own_memory_bytes(station or client.address))
        except (VaoiError, OSError) as error:
            noted.refused.append(str(error))
        waiting.wait(pause_s)
    noted.missed = client.get("/station")["boards_missed"] - missed
    return noted


def own_memory_bytes(address: str) -> float:
    """Return the memory of the station process without the shared part."""
    with urllib.request.urlopen(f"{address}/metrics", timeout=30) as reply:
        parts = {name: float(value) for name, value in _MEMORY.findall(reply.read().decode())}
    return parts["resident"] - parts["shared"]


def as_table(rows: Sequence[tuple[str, Experience]]) -> str:
    """Return the figures as a table in Markdown."""
    lines = [
        "| attack | boards, missed | matrices: median, p99, longest, ms | refused | latest result, ms | memory, MB "
        "| processor: station, attacker, % |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, noted in rows:
        times = ", ".join(f"{1000 * noted.quantile_s(share):.0f}" for share in (0.5, 0.99, 1))
        refused = f"{len(noted.refused)} of {len(noted.waits_s) + len(noted.refused)}"
        lines.append(
            f"| {name.replace('_', ' ')} | {len(noted.runs)}, {noted.missed} | {times} | {refused} "
            f"| {noted.late_ms:.0f} | {noted.memory_bytes / 1e6:.0f} "
            f"| {', '.join(f'{100 * share:.0f}' for share in noted.busy)} |"
        )
    return "\n".join(lines)
