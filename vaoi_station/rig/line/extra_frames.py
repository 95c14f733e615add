"""Render frames on demand: for a pulse at an unexpected time, under an unexpected light, or while no board passes.

A separate process draws the twin at the first request and renders while the station waits. Such frames arrive late, but
they show the scene that is under the cameras.
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
class FrameRequest:
    """A request to render one frame of every camera for one moment."""

    board: int | None
    """Number of the board; None: the calibration board, which lies under the cameras while no board passes."""
    time_s: float = 0.0
    """Time since the start of the passage."""
    light: str = ""
    noise: int = 0
    """Seed of the frames' noise; another number gives other noise."""


class FrameRenderer:
    """Renderer of frames on demand. It runs in one separate process and serves one request at a time."""

    def __init__(self, scenario: Scenario, folder: Path) -> None:
        """Prepare the renderer, which creates `folder` for its frames. The process starts at the first request."""
        self._scenario, self._folder = scenario, folder
        self._numbers = count()
        self._calibration_board: Path | None = None
        self._process: BaseProcess | None = None
        self._connection: Connection[Any, Any] | None = None
        self._rendering = threading.Lock()

    def render(self, request: FrameRequest) -> Path:
        """Render one frame per camera; return the file with the flat bytes of all frames, in the order of the cameras.

        Raises:
            InternalError: the process has ended.
        """
        with self._rendering:
            # The calibration board does not move, so its frames are rendered once.
            if request.board is None and self._calibration_board is not None:
                return self._calibration_board
            path = self._folder / f"request-{next(self._numbers):06d}.raw"
            connection = self._connection or self._open()
            try:
                connection.send((request, path))
                connection.recv()
            except (EOFError, OSError) as error:
                raise InternalError("the process that renders frames on demand has ended.") from error
            if request.board is None:
                self._calibration_board = path
            return path

    def close(self) -> None:
        """End the rendering process, if it runs."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.join()

    def _open(self) -> Connection[Any, Any]:
        self._folder.mkdir(exist_ok=True)
        spawn = multiprocessing.get_context("spawn")
        self._connection, there = spawn.Pipe()
        self._process = spawn.Process(
            target=render_worker, args=(self._scenario, there), name="vaoi-extra-frames", daemon=True
        )
        self._process.start()
        # This end must be closed here, or recv() would wait for ever after the process has ended.
        there.close()
        return self._connection


def render_worker(scenario: Scenario, connection: Connection[Any, Any]) -> None:
    """Serve requests until the pipe is closed: receive a request and a path, write the frames, return the path."""
    twin = Twin(scenario)
    with contextlib.suppress(EOFError, ConnectionResetError, BrokenPipeError, KeyboardInterrupt), connection:
        while True:
            request, path = connection.recv()
            np.concatenate(list(_frames(twin, request))).tofile(path)
            connection.send(path)


def _frames(twin: Twin, request: FrameRequest) -> Iterator[NDArray[np.uint8]]:
    if request.board is None:
        for _, _, image in calibration_board.frames(twin):
            yield to_bytes(image)
        return
    passage = twin.passage(request.board)
    for camera in range(twin.scenario.array.cameras):
        yield to_bytes(passage.frame_at(camera, request.time_s, request.light, request.noise))
