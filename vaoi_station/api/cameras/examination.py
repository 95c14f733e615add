"""Runs `vaoi doctor` for callers, in a process of its own: its libraries do not stay in the station's memory."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from pathlib import Path

from pydantic import ValidationError

from vaoi_station.api.cameras.models import Examination
from vaoi_station.errors import DeviceError, NotFoundError

LIMIT_S = 60.0
"""Longest time of an examination."""
KEPT_S = 10.0
"""Time for which an answer is given again, so that several pages cause one examination."""
LOWEST_PRIORITY = 19


class Examinations:
    """Examines the station of a station.toml, one examination at a time. Its methods may be called from any thread."""

    def __init__(self, config: Path | None) -> None:
        self._config = config
        self._running = threading.Lock()
        self._last: tuple[float, Examination] | None = None

    def examine(self) -> Examination:
        """Return all findings.

        Raises:
            NotFoundError: the station does not know its station.toml.
            DeviceError: the examination has failed.
        """
        if self._config is None:
            raise NotFoundError(
                "This station was started without a station.toml, which vaoi doctor needs.",
                action="Start it by vaoi serve --config station.toml.",
                code="not-examinable",
            )
        with self._running:
            if self._last is None or time.monotonic() - self._last[0] > KEPT_S:
                found = _run(self._config)
                self._last = (time.monotonic(), found)
            return self._last[1]


def _run(config: Path) -> Examination:
    command = [sys.executable, "-m", "vaoi_station", "doctor", "--json", "--config", str(config)]
    try:
        done = subprocess.run(
            ["nice", "-n", str(LOWEST_PRIORITY), *command], capture_output=True, timeout=LIMIT_S, check=False
        )
        return Examination.model_validate(json.loads(done.stdout))
    except (OSError, subprocess.TimeoutExpired, ValueError, ValidationError) as error:
        raise DeviceError(
            f"vaoi doctor did not examine the station: {type(error).__name__}.",
            action=f"Run vaoi doctor --config {config} on the station's machine.",
            code="examination-failed",
        ) from error
