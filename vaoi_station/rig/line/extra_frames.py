"""Frames that no film has: a pulse at another time or under another light, or while no board passes.

A process of its own draws the twin when the first one is asked for, and renders while the station waits: such frames
come late, but they show what is under the cameras.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.simulated.board import to_bytes
from vaoi_station.errors import InternalError
from vaoi_station.simulation import Scenario, Twin, calibration_board


@dataclass(frozen=True)
class View:
    """What is to be seen by all cameras."""

    board: int | None
    """None: the calibration board, which lies still under the cameras while no board passes."""
    time_s: float = 0.0
    """Since the passage's start."""
    light: str = ""
    noise: int = 0


class Darkroom:
    """Owns its process; used by one thread at a time."""

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        """`folder` takes the pictures; it is made when it is needed."""
        self._scenario, self._folder = scenario, folder
        self._numbers = count()
        self._still: Path | None = None
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self._working = threading.Lock()

    def develop(self, view: View) -> Path:
        """A file with the flat bytes of every camera's frame, one behind the other.

        Raises:
            InternalError: the process has ended.
        """
        with self._working:
            if view.board is None and self._still is not None:
                return self._still
            path = self._folder / f"view-{next(self._numbers):06d}.raw"
            connection = self._connection or self._open()
            try:
                connection.send((view, path))
                connection.recv()
            except (EOFError, OSError) as error:
                raise InternalError("the process that renders frames on demand has ended.") from error
            if view.board is None:
                self._still = path
            return path

    def close(self) -> None:
        """End the process."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.join()

    def _open(self) -> Connection[Any, Any]:
        self._folder.mkdir(exist_ok=True)
        spawn = multiprocessing.get_context("spawn")
        self._connection, there = spawn.Pipe()
        self._process = spawn.Process(target=work, args=(self._scenario, there), name="vaoi-darkroom", daemon=True)
        self._process.start()
        there.close()
        return self._connection


def work(scenario: Scenario, connection: Connection[Any, Any]) -> None:
    """Render until the pipe ends: a view and a path come in, the path goes back."""
    twin = Twin(scenario)
    with contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError, KeyboardInterrupt), connection:
        while True:
            view, path = connection.recv()
            np.concatenate(list(_frames(twin, view))).tofile(path)
            connection.send(path)


def _frames(twin: Twin, view: View) -> Iterator[NDArray[np.uint8]]:
    if view.board is None:
        for _, _, image in calibration_board.frames(twin):
            yield to_bytes(image)
        return
    passage = twin.passage(view.board)
    for camera in range(twin.scenario.array.cameras):
        yield to_bytes(passage.frame_at(camera, view.time_s, view.light, view.noise))
