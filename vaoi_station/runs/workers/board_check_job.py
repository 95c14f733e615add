"""The job of laying a board type over a run, and its execution in a worker."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from vaoi_station.board_check.check import check_board
from vaoi_station.board_check.picture import picture_of_check
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.files.images import encode_jpeg
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Stitch
from vaoi_station.runs.workers.jobs import FramesJob, Priority
from vaoi_station.stitching.matching.evidence import FrameKey


class CheckedBoard(NamedTuple):
    """The reply: the report, and the picture as JPEG."""

    report: BoardCheck
    picture: bytes


@dataclass(frozen=True)
class BoardCheckJob(FramesJob):
    """Lay a board type over a run; the reply's value is a `CheckedBoard`."""

    run: str
    bay: int
    generation: int
    slots: Mapping[FrameKey, int]
    """Slots of the usable frames."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras with which the run was stitched."""
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    own: BoardType
    """The board type with which the run was stitched."""
    board_type: BoardType
    """The board type that is checked."""
    # It takes seconds, so everything else comes first.
    priority: Priority = Priority.HEIGHTS
    request: int = 0
    # A second worker would take as long, and could not be asked for pictures meanwhile.
    repeatable: ClassVar[bool] = False
    longest_s: ClassVar[float | None] = 180.0

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> CheckedBoard:
        """Check the board type; `frame` returns the pixels of a slot."""

        def pixels(camera: int, row: int) -> NDArray[Any] | None:
            slot = self.slots.get((camera, row))
            return None if slot is None else frame(slot)

        run = CheckedRun(self.stitch, self.stitch.cameras(self.cameras), pixels, self.lights, self.own)
        report = check_board(run, self.board_type)
        return CheckedBoard(report, encode_jpeg(picture_of_check(run, self.board_type, report)))

    def __str__(self) -> str:
        return f"the check of board type {self.board_type.name!r} against run {self.run}"
