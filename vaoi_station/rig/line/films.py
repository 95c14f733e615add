"""Boards filmed before they pass: frames for the very times at which the firmware will fire, and the truth.

The twin's boards move as their scenario says, and the firmware's rule is known; so the times of all pulses, bounces
included, are known beforehand to a fraction of a microsecond, and nothing is rendered while a board passes.
"""

from __future__ import annotations

import hashlib
import json
import math
import mmap
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.simulated.board import barrier_edges, predict_pulses, to_bytes
from vaoi_station.errors import DeviceError, InputError, InternalError
from vaoi_station.files import read_board_type, read_calibration, write_board_type, write_calibration
from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.model import BoardType, Calibration, Strict
from vaoi_station.simulation import Passage, Scenario, Twin
from vaoi_station.simulation.truth import views

_FRAMES, _SHEET, _CALIBRATION, _BOARD_TYPE = "frames.raw", "film.json", "calibration.json", "board.json"
_FORMAT = 1
"""Of the directory; older ones are filmed anew."""


class Sheet(Strict):
    """What was filmed; all times are seconds since the passage's start."""

    board: int
    cameras: int
    frame_bytes: int
    edges: tuple[tuple[float, bool], ...]
    """When the light barrier changes, and whether it is interrupted from then on."""
    pulses_s: tuple[float, ...]
    lights: tuple[str, ...]
    """Of every pulse."""
    lost: tuple[tuple[int, int], ...]
    """(camera, row) that the scenario keeps from arriving."""
    views: dict[str, tuple[tuple[float, float, float, float], ...]]
    """The truth: camera, row, x, y of the middle of every component's footprint, raw pixels."""


@dataclass(frozen=True)
class Film:
    """One board in a directory; picture number row · cameras + camera."""

    directory: Path

    @property
    def frames(self) -> Path:
        """All frames, one behind the other."""
        return self.directory / _FRAMES

    @cached_property
    def sheet(self) -> Sheet:
        """What was filmed."""
        path = self.directory / _SHEET
        return parse(Sheet, read_json(path), path)

    @property
    def calibration(self) -> Calibration:
        """That of the array."""
        return read_calibration(self.directory / _CALIBRATION)

    @property
    def board_type(self) -> BoardType:
        """What was on the belt."""
        return read_board_type(self.directory / _BOARD_TYPE)

    @property
    def rows(self) -> int:
        """Pulses of the passage."""
        return len(self.sheet.pulses_s)

    @property
    def complete(self) -> bool:
        """Whether it was filmed to its end."""
        return (self.directory / _SHEET).is_file()

    @property
    def lasts_s(self) -> float:
        """From the passage's start to its last pulse or change of the barrier."""
        return max(self.sheet.pulses_s[-1:] + tuple(t for t, _ in self.sheet.edges))

    def warm(self) -> None:
        """Read it once, so that no camera waits for a disk."""
        chunk = bytearray(1 << 22)
        with self.frames.open("rb", buffering=0) as file:
            while file.readinto(chunk):
                pass

    def map(self) -> NDArray[np.uint8]:
        """Flat bytes of all frames, (rows, cameras, bytes), read-only; nothing is copied."""
        with self.frames.open("rb") as file:
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(memory, np.uint8).reshape(self.rows, self.sheet.cameras, self.sheet.frame_bytes)


def films(scenario: Scenario, boards: Sequence[int], directory: Path, tell: Callable[[str], None]) -> tuple[Film, ...]:
    """Boards of a scenario by their numbers, each in a directory of its own; those filmed before are used again.

    The drawn board may take gigabytes: a process of its own draws and films, and gives them back.

    Raises:
        DeviceError: there is no place for them, or no room.
        InternalError: the process ended with something else than films.
    """
    made = tuple(Film(directory / _key(scenario, board)) for board in boards)
    absent = [n for n, film in enumerate(made) if not film.complete]
    if absent:
        tell(f"Filming {len(absent)} board(s) of {scenario.board.width_mm:.0f} × {scenario.board.length_mm:.0f} mm.")
        _film_aside(scenario, [boards[n] for n in absent], [made[n].directory for n in absent])
    return made


def _film_aside(scenario: Scenario, boards: Sequence[int], directories: Sequence[Path]) -> None:
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe(duplex=False)
    process = spawn.Process(target=film_boards, args=(scenario, boards, directories, there), name="vaoi-films")
    try:
        with _deaf_children():
            process.start()
        there.close()
        with here:
            words = here.recv()
    except EOFError:
        words = ""
    except BaseException:  # Ctrl-C most of all: nobody wants the films any more
        if process.is_alive():
            process.terminate()
        raise
    finally:
        if process.pid is not None:
            process.join()
    if words:
        raise DeviceError(f"films cannot be kept: {words}.", action="Make room there, or give another --films.")
    if process.exitcode:
        raise InternalError(f"filming ended with code {process.exitcode}; its words are above.")


@contextmanager
def _deaf_children() -> Iterator[None]:
    """Processes that are started meanwhile do not hear Ctrl-C, from their first moment on; it is ours to answer."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def film_boards(
    scenario: Scenario, boards: Sequence[int], directories: Sequence[Path], connection: Connection[Any, Any]
) -> None:
    """Render boards into directories; a film's sheet is written last.

    What the system refuses is told over the connection, which is closed without a word otherwise. Ends with the parent.
    """
    threading.Thread(target=_end_with_parent, daemon=True).start()
    twin = Twin(scenario)
    with connection:
        try:
            for board, directory in zip(boards, directories, strict=True):
                _film(twin.passage(board), directory)
        except (OSError, InputError) as error:
            told = f"{error.filename or directories[0]}: {error.strerror}" if isinstance(error, OSError) else str(error)
            connection.send(told.removesuffix("."))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)  # nothing is half-written: a film without its sheet is none


def _film(passage: Passage, directory: Path) -> None:
    twin, cameras = passage.twin, passage.twin.scenario.array.cameras
    edges = barrier_edges(passage)
    pulses = predict_pulses(edges, TriggerPlan.of(twin.line, twin.scenario.line.lights))
    array = twin.scenario.array
    frame_bytes = array.width_px * array.height_px * array.bits // 8
    directory.mkdir(parents=True, exist_ok=True)
    _ = twin.scene, passage.placements  # drawn once, before threads ask for them
    frames = _room(directory / _FRAMES, (len(pulses), cameras, frame_bytes))

    def render(row: int) -> None:
        for camera in range(cameras):
            frames[row, camera] = to_bytes(passage.frame_at(camera, pulses[row].time_s, pulses[row].light, row))

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(render, range(len(pulses))))
    write_calibration(directory / _CALIBRATION, twin.calibration)
    write_board_type(directory / _BOARD_TYPE, twin.board_type)
    sheet = Sheet(
        board=passage.board_number,
        cameras=cameras,
        frame_bytes=frame_bytes,
        edges=tuple(edges),
        pulses_s=tuple(pulse.time_s for pulse in pulses),
        lights=tuple(pulse.light for pulse in pulses),
        lost=tuple((c, r) for r in range(len(pulses)) for c in range(cameras) if passage.faults.lost(c, r)),
        views=views(twin, passage.pinholes, [passage.pose(pulse.time_s) for pulse in pulses]),
    )
    write_json(directory / _SHEET, sheet.model_dump(mode="json"))


def _room(path: Path, shape: tuple[int, int, int]) -> NDArray[Any]:
    """Every block is taken now: writing into a hole of a full disk would end the process by a signal."""
    size_bytes = math.prod(shape)
    with path.open("wb") as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size_bytes)
        except OSError as error:
            path.unlink()
            raise OSError(error.errno, f"{size_bytes / 1e6:.0f} MB: {error.strerror}", str(path)) from error
    frames: NDArray[Any] = np.memmap(path, np.uint8, "r+", shape=shape)
    return frames


def _key(scenario: Scenario, board: int) -> str:
    """A name for one board of a scenario, whatever goes wrong with the others."""
    befallen = {
        name: [fault.model_dump(mode="json") for fault in faults if getattr(fault, "board", None) in (None, board)]
        for name, faults in scenario.faults
    }
    alone = scenario.model_dump(mode="json", exclude={"faults"}) | {k: v for k, v in befallen.items() if v}
    digest = hashlib.sha256(json.dumps([_FORMAT, board, alone]).encode()).hexdigest()
    return f"{scenario.board.name}-{board:03d}-{digest[:12]}"
