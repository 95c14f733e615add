"""Render frames of the twin: whole boards before they pass, and single frames on demand.

The motion of a board follows from the scenario, and the firmware's rule is known: the times of all pulses can be
computed beforehand to a fraction of a microsecond, even with bounces. Frames for unexpected pulses are rendered while
the station waits; they arrive late.
"""

from __future__ import annotations

import contextlib
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
from itertools import count
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.simulated import barrier_edges, predict_pulses, to_bytes
from vaoi_station.errors import DeviceError, InputError, InternalError
from vaoi_station.files import read_board_type, read_calibration, write_board_type, write_calibration
from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.model import BoardType, Calibration, Strict
from vaoi_station.model.recording import row_of
from vaoi_station.simulation import Passage, Scenario, Twin, calibration_board
from vaoi_station.simulation.truth import views

_FRAMES, _METADATA, _CALIBRATION, _BOARD_TYPE = "frames.raw", "film.json", "calibration.json", "board.json"
_FORMAT = 1
"""Version of the files in a rendered board's directory; boards of another version are rendered again."""


class BoardMetadata(Strict):
    """Times, lights and truth of a rendered board. All times are in seconds since the start of the passage."""

    board: int
    cameras: int
    frame_bytes: int
    edges: tuple[tuple[float, bool], ...]
    """(time, interrupted) of each change of the light barrier; `interrupted` is its state after the change."""
    pulses_s: tuple[float, ...]
    counts_s: tuple[float, ...] = ()
    """Time of each count of the belt's encoder; empty if the controller's clock spaces the rows."""
    lights: tuple[str, ...]
    lost: tuple[tuple[int, int], ...]
    views: dict[str, tuple[tuple[float, float, float, float], ...]]
    """The truth: component → (camera, row, x, y) of the centre of its footprint in each view, x and y in raw pixels."""


@dataclass(frozen=True)
class RenderedBoard:
    """One rendered board in a directory. In its file, the frame of (camera, row) has index row · cameras + camera."""

    directory: Path

    @property
    def frames_path(self) -> Path:
        """The file with the bytes of all frames, one frame after the other."""
        return self.directory / _FRAMES

    @cached_property
    def metadata(self) -> BoardMetadata:
        """Times, lights and truth of the board, read from its directory."""
        path = self.directory / _METADATA
        return parse(BoardMetadata, read_json(path), path)

    @property
    def calibration(self) -> Calibration:
        """The calibration of the twin's cameras, read from the directory."""
        return read_calibration(self.directory / _CALIBRATION)

    @property
    def board_type(self) -> BoardType:
        """The board type, read from the directory."""
        return read_board_type(self.directory / _BOARD_TYPE)

    @property
    def rows(self) -> int:
        """Number of pulses of the passage."""
        return len(self.metadata.pulses_s)

    @property
    def complete(self) -> bool:
        """Whether the directory is complete. The metadata is written last, so its presence shows this."""
        return (self.directory / _METADATA).is_file()

    @property
    def duration_s(self) -> float:
        """Time from the start of the passage to the last pulse or the last change of the barrier."""
        return max(self.metadata.pulses_s[-1:] + tuple(t for t, _ in self.metadata.edges))

    def load_into_cache(self) -> None:
        """Read the file of frames once into the page cache, so that no camera has to wait for a disk."""
        chunk = bytearray(1 << 22)
        with self.frames_path.open("rb", buffering=0) as file:
            while file.readinto(chunk):
                pass

    def map_frames(self) -> NDArray[np.uint8]:
        """Return the flat bytes of all frames, (rows, cameras, bytes), as a read-only memory map."""
        with self.frames_path.open("rb") as file:
            memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return np.frombuffer(memory, np.uint8).reshape(self.rows, self.metadata.cameras, self.metadata.frame_bytes)


def render_boards(
    scenario: Scenario, boards: Sequence[int], directory: Path, progress: Callable[[str], None]
) -> tuple[RenderedBoard, ...]:
    """Return rendered boards of a scenario, each in a separate directory; render those that are not there yet.

    A separate process draws and renders, because a drawn board may need gigabytes of memory; they are free again when
    the process ends.
    """
    rendered = tuple(RenderedBoard(directory / _directory_name(scenario, board)) for board in boards)
    missing = [n for n, board in enumerate(rendered) if not board.complete]
    if missing:
        progress(
            f"Rendering {len(missing)} board(s) of {scenario.board.width_mm:.0f} × {scenario.board.length_mm:.0f} mm."
        )
        _render_in_process(scenario, [boards[n] for n in missing], [rendered[n].directory for n in missing])
    return rendered


def _render_in_process(scenario: Scenario, boards: Sequence[int], directories: Sequence[Path]) -> None:
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe(duplex=False)
    process = spawn.Process(target=render_worker, args=(scenario, boards, directories, there), name="vaoi-render")
    try:
        with _sigint_blocked():
            process.start()
        # This end must be closed here, or recv() would wait for ever after the process has ended.
        there.close()
        with here:
            reason = here.recv()
    except EOFError:
        reason = ""
    except BaseException:  # mainly Ctrl-C: the caller no longer needs the boards
        if process.is_alive():
            process.terminate()
        raise
    finally:
        if process.pid is not None:
            process.join()
    if reason:
        raise DeviceError(
            f"rendered boards cannot be stored: {reason}.", action="Free space there, or give another --films."
        )
    if process.exitcode:
        raise InternalError(f"rendering ended with code {process.exitcode}; its message is above.")


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Block the signal SIGINT in a `with` block.

    A process that is started in the block inherits this, so that Ctrl-C reaches the parent process only.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def render_worker(
    scenario: Scenario, boards: Sequence[int], directories: Sequence[Path], connection: Connection[Any, Any]
) -> None:
    """Render each board into its directory. This function is the main function of the rendering process.

    If a file cannot be written, the error is sent over the connection. On success the connection is closed without a
    message. The process ends when its parent ends.
    """
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    twin = Twin(scenario)
    with connection:
        try:
            for board, directory in zip(boards, directories, strict=True):
                _render_board(twin.passage(board), directory)
        except (OSError, InputError, DeviceError) as error:
            reason = (
                f"{error.filename or directories[0]}: {error.strerror}" if isinstance(error, OSError) else str(error)
            )
            connection.send(reason.removesuffix("."))


def _exit_with_parent() -> None:
    """Wait until the parent process has ended, then end this process."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)  # half-written files do no harm: without its metadata a board is incomplete


def _render_board(passage: Passage, directory: Path) -> None:
    twin, cameras = passage.twin, passage.twin.scenario.array.cameras
    edges = barrier_edges(passage)
    pulses = predict_pulses(edges, TriggerPlan.of(twin.line, twin.scenario.line.lights, twin.program), passage.encoder)
    array = twin.scenario.array
    frame_bytes = array.width_px * array.height_px * array.bits // 8
    directory.mkdir(parents=True, exist_ok=True)
    # These cached properties are computed once here, because the threads below would each compute them.
    _ = twin.scene, passage.placements
    frames = _allocate_frames(directory / _FRAMES, (len(pulses), cameras, frame_bytes))

    def render(row: int) -> None:
        for camera in range(cameras):
            filmed = row_of(twin.program, row)
            image = passage.frame_at(camera, pulses[row].time_s, pulses[row].light, row, filmed)
            frames[row, camera] = to_bytes(image)

    # Threads use all cores here, because OpenCV and numpy release the GIL in the expensive parts.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        list(pool.map(render, range(len(pulses))))
    write_calibration(directory / _CALIBRATION, twin.calibration)
    write_board_type(directory / _BOARD_TYPE, twin.board_type)
    metadata = BoardMetadata(
        board=passage.board_number,
        cameras=cameras,
        frame_bytes=frame_bytes,
        edges=tuple(edges),
        pulses_s=tuple(pulse.time_s for pulse in pulses),
        counts_s=() if passage.encoder is None else tuple(passage.encoder.steps_s.round(9).tolist()),
        lights=tuple(pulse.light for pulse in pulses),
        lost=tuple((c, r) for r in range(len(pulses)) for c in range(cameras) if passage.faults.lost(c, r)),
        views=views(twin.scenario.board, twin.parts, passage.pinholes, [passage.pose(p.time_s) for p in pulses]),
    )
    # Written last: its presence marks the board as complete.
    write_json(directory / _METADATA, metadata.model_dump(mode="json"))


def _allocate_frames(path: Path, shape: tuple[int, int, int]) -> NDArray[Any]:
    """Create the file of frames, with all its disk blocks allocated, and return it as a writable memory map."""
    size_bytes = math.prod(shape)
    with path.open("wb") as file:
        try:
            # Without allocated blocks, a write to the memory map on a full disk would end the process by SIGBUS.
            os.posix_fallocate(file.fileno(), 0, size_bytes)
        except OSError as error:
            path.unlink()
            raise OSError(error.errno, f"{size_bytes / 1e6:.0f} MB: {error.strerror}", str(path)) from error
    frames: NDArray[Any] = np.memmap(path, np.uint8, "r+", shape=shape)
    return frames


def _directory_name(scenario: Scenario, board: int) -> str:
    """Return the directory name of one board of a scenario. Faults of other boards do not change this name."""
    own_faults = {
        name: [fault.model_dump(mode="json") for fault in faults if getattr(fault, "board", None) in (None, board)]
        for name, faults in scenario.faults
    }
    own = scenario.model_dump(mode="json", exclude={"faults"}) | {k: v for k, v in own_faults.items() if v}
    digest = hashlib.sha256(json.dumps([_FORMAT, board, own]).encode()).hexdigest()
    return f"{scenario.board.name}-{board:03d}-{digest[:12]}"


@dataclass(frozen=True)
class FrameRequest:
    """A request to render one frame of every camera for one moment."""

    board: int | None
    """Number of the board; None: the calibration board, which lies under the cameras while no board passes."""
    time_s: float = 0.0
    light: str = ""
    noise: int = 0


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
        """Render one frame per camera; return the file with all frames, by camera."""
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
            target=render_on_demand, args=(self._scenario, there), name="vaoi-extra-frames", daemon=True
        )
        self._process.start()
        # This end must be closed here, or recv() would wait for ever after the process has ended.
        there.close()
        return self._connection


def render_on_demand(scenario: Scenario, connection: Connection[Any, Any]) -> None:
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
