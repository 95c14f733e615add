"""Measure the wall time of consecutive stages."""

from __future__ import annotations

import time
from dataclasses import dataclass, field


@dataclass
class StageTimes:
    """Wall times of consecutive stages in ms, by name.

    The first stage begins when this object is created, every other stage when the stage before it ends.
    """

    ms: dict[str, float] = field(default_factory=dict)
    _last: float = field(default_factory=time.perf_counter)

    def finish(self, name: str) -> None:
        """End the current stage and record its wall time under `name`."""
        now = time.perf_counter()
        self.ms[name] = round((now - self._last) * 1e3, 3)
        self._last = now
