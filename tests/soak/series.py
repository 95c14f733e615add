"""The series of a soak: what was sampled after every board, as lives of processes, each with its slope."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from tests.soak.slopes import LEAST_BLOCKS, WARM_UP, Array, Slope, block_medians, slope_of

ROLES = ("station", "acquisition", "worker 0", "worker 1")
OF_PROCESS = {
    "rss_mb": "resident memory, MB",
    "anonymous_mb": "private memory, MB",
    "descriptors": "descriptors",
    "threads": "threads",
}
OF_FILES = {
    "database_mb": "database with its log, MB",
    "data_mb": "data directory, MB",
    "data_files": "files of the data directory",
    "shared_memory_mb": "shared memory, MB",
    "shared_memory_files": "files in shared memory",
}
OF_RUNS = {
    "result_ms": "last frame to result, ms",
    "announced_ms": "last frame to announcement, ms",
}
Sample = Mapping[str, Any]


class Series(NamedTuple):
    """One quantity over the boards of a soak."""

    name: str
    key: str
    lives: list[tuple[Array, Array]]
    """(boards, values) of every life of its process, in order."""
    slope: Slope | None
    """None if every life is too short."""

    def document(self) -> dict[str, Any]:
        """Return slope and block medians for JSON."""
        reduced = [block_medians(x, y) for x, y in self.lives if len(x) >= LEAST_BLOCKS]
        return {
            "name": self.name,
            "slope": self.slope and {**self.slope._asdict(), "flat": self.slope.flat},
            "lives": [[x.round(1).tolist(), y.round(3).tolist()] for x, y in reduced],
        }


def all_series(samples: Sequence[Sample], warm_up: int = WARM_UP) -> list[Series]:
    """Return every series of a soak."""
    found = []
    for role in ROLES:
        for key, words in OF_PROCESS.items():
            used = [s["processes"].get(role, {}) for s in samples]
            lives = _lives(used, key, lambda u: u.get("pid"))
            found.append(Series(f"{role}: {words}", key, lives, slope_of(lives, warm_up)))
    for key, words in OF_FILES.items():
        lives = _lives(samples, key, lambda _: 0)
        found.append(Series(words, key, lives, slope_of(lives, warm_up)))
    for key, words in OF_RUNS.items():
        lives = _lives(samples, key, lambda s: s["processes"].get("station", {}).get("pid"))
        found.append(Series(words, key, lives, slope_of(lives, warm_up)))
    return found


def _lives(samples: Sequence[Sample], key: str, identity: Callable[[Sample], object]) -> list[tuple[Array, Array]]:
    """Return (boards, values) for each identity, in order of appearance."""
    lives: dict[object, list[tuple[float, float]]] = {}
    for board, sample in enumerate(samples):
        value = sample.get(key)
        if value is not None and math.isfinite(value):
            lives.setdefault(identity(sample), []).append((float(board), float(value)))
    return [(np.array([x for x, _ in life]), np.array([y for _, y in life])) for life in lives.values()]
