"""Jobs that measure the parts of a run, and that keep what a good board looks like.

Both run in steps, one kind of parts after the other. Most take some tens of milliseconds; the first of a kind, in which
a worker learns what good parts look like, takes longer, a second for some thousand patches.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

from numpy.typing import NDArray

from vaoi_station.errors import InputError
from vaoi_station.files.images import Image, encode_png, read_kept_image
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, RecordingHead, Stitch
from vaoi_station.parts.document import Remark, changes, dark_lights, disagreement_steps, measure_parts, parts_document
from vaoi_station.parts.learned import TaughtBoard, joined, parts_digest, read_taught_board
from vaoi_station.parts.measure import Run, SoFar
from vaoi_station.parts.models import Models
from vaoi_station.parts.neighbours import as_picture, difference, neighbour
from vaoi_station.parts.patches import ViewClass, kind_of
from vaoi_station.runs.workers.jobs import Priority, ReadSlot, SteppedJob
from vaoi_station.runs.workers.picture_jobs import Slots, reader
from vaoi_station.steps import Steps
from vaoi_station.stitching.matching.evidence import FrameKey

GoodFiles = tuple[tuple[Path, int], ...]
"""Files of good boards, with the times of their last changes, ns."""
_STEP_PARTS = 32
"""Number of parts that are measured in one step."""
_KEPT_FRAMES = 48
"""Number of frames of a recording that are kept in memory, so that those that show many parts are read once."""
MOST_GOOD = 20
"""Largest number of good boards of a board type: a worker has all of them in memory, 2.2 kB a part and board."""


@dataclass(frozen=True)
class _PartsOfRun(SteppedJob):
    """A job on the parts of a run."""

    awaited_s: ClassVar[float | None] = 600.0
    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    head: RecordingHead
    slots: Slots
    """Slots of the usable frames."""
    calibration: str
    """Digest of the calibration."""
    good: GoodFiles
    """The good boards; for `TeachJob`, the other ones."""
    files: Mapping[FrameKey, Path] | None = field(default=None, kw_only=True)
    """The files of the frames in the run's recording; None: they are in the ring."""

    @property
    def recorded(self) -> bool:
        """Whether no frame is read from the ring."""
        return self.files is not None

    def opened(self, frame: ReadSlot) -> Run:
        """Return the run, with the pixels of its usable frames."""
        files = self.files

        @lru_cache(_KEPT_FRAMES)
        def recorded(camera: int, row: int) -> Image | None:
            return read_kept_image(files[camera, row]) if files and (camera, row) in files else None

        pixels = reader(self.slots, frame) if files is None else recorded
        return Run(self.board_type, self.stitch, self.cameras, self.head, pixels)


@dataclass(frozen=True)
class PartsJob(_PartsOfRun):
    """Measure all parts of a run; the reply's value is their document (JSON)."""

    what: ClassVar[str] = "the parts"
    priority: Priority = field(default=Priority.HEIGHTS, kw_only=True)

    def steps(self, frame: ReadSlot) -> Steps[bytes]:
        """Measure some parts in each step."""
        known: list[TaughtBoard] = []
        remarks: list[Remark] = []
        for path, changed_ns in self.good:
            try:
                known.append(_board(path, changed_ns))
            except InputError as error:  # The other good boards hold.
                remarks.append(Remark("good-board-unusable", {"why": error.message}))
            yield
        if others := [board.name for board in known if not board.is_of(self.board_type)]:
            remarks.append(Remark("good-board-of-other-type", {"boards": others}))
            known = [board for board in known if board.name not in others]
        models = _models(tuple(known))
        run = self.opened(frame)
        measured: dict[str, dict[str, Any]] = {}
        so_far = SoFar()
        for some in _in_steps(self.board_type):
            for first in range(0, len(some), _STEP_PARTS):
                measured |= measure_parts(run, models, some[first : first + _STEP_PARTS], so_far)
                yield
        in_order = {part.address: measured[part.address] for part in self.board_type.components}
        remarks += dark_lights(so_far) + changes(run, models.boards, self.calibration, self.run)
        document = parts_document(run, models, in_order, remarks)
        # As in all replies of the station, what is not known is absent.
        document["parts"] = {
            address: {key: value for key, value in part.items() if value is not None}
            for address, part in document["parts"].items()
        }
        return json.dumps(document, ensure_ascii=False).encode()


class Taught(NamedTuple):
    """What was kept of a good board."""

    parts: int
    """Number of parts of which frames show enough."""
    size_bytes: int
    disagreements: list[dict[str, Any]]
    """Parts of good boards that look unlike others of their kind, as `disagreement_steps` returns them."""


@dataclass(frozen=True)
class TeachJob(_PartsOfRun):
    """Keep what the parts of a good board look like in a file; the reply's value is a `Taught`."""

    what: ClassVar[str] = "the parts of a good board"
    file: Path

    def steps(self, frame: ReadSlot) -> Steps[Taught]:
        """Cut the patches of some parts in each step, write the file, and compare the good boards."""
        run = self.opened(frame)
        # Read before anything is kept: if one is damaged, the board is not kept either.
        others = []
        for path, changed_ns in self.good:
            if (other := _board(path, changed_ns)).is_of(self.board_type):
                others.append(other)
            yield
        digest, pieces, tops = parts_digest(self.board_type), [], _models(tuple(others)).heights_mm
        for some in _in_steps(self.board_type):
            pieces.append(TaughtBoard.of_run(self.run, run.cut_on_tops(some, tops), digest, self.calibration))
            yield
        board = joined(pieces)
        board.write(self.file)
        yield
        disagreements = yield from disagreement_steps((*others, board))
        known = sum(int((patches.any((1, 2, 3))).sum()) for patches in board.patches)
        return Taught(known, self.file.stat().st_size, disagreements)


class PartView(NamedTuple):
    """The pictures (PNG) of a part under one light: its own, that of its good neighbour, and their difference."""

    light: str
    exposure: float
    part: bytes
    good: bytes | None
    difference: bytes | None


class PartViews(NamedTuple):
    """The pictures of a part by view class, and the good board that is most like it there."""

    good: str | None = None
    views: tuple[PartView, ...] = ()


@dataclass(frozen=True)
class PartViewsJob(_PartsOfRun):
    """Make the pictures of one part and of its good neighbour; the reply's value is a `PartViews`.

    Of a good board without frames (`files` is empty), they are what was kept of it.
    """

    what: ClassVar[str] = "the pictures of a part"
    part: Component

    def steps(self, frame: ReadSlot) -> Steps[PartViews]:
        """Read the good boards, and cut and compare the pictures."""
        known = []
        for path, changed_ns in self.good:
            with suppress(InputError):  # The measures of the run say that it cannot be used.
                known.append(_board(path, changed_ns))
            yield
        others = [board for board in known if board.name != self.run and board.is_of(self.board_type)]
        shown: dict[ViewClass, NDArray[Any]] = {}
        if self.files == {}:
            for board in known:
                shown |= board.views(self.part.address) if board.name == self.run else {}
        else:
            heights_mm = _models(tuple(known)).heights_mm
            patches = self.opened(frame).cut([self.part], heights_mm=heights_mm)
            seen = patches.frames[0].tolist()
            shown |= {view: patches.values[0, n][0] for n, view in enumerate(patches.classes) if seen[n]}
        found = neighbour(shown, others, self.part.address)
        views = []
        for view, own in shown.items():
            good = None if found is None else found.pictures.get(view)
            beside = (None, None) if good is None else (as_picture(good), difference(own, good))
            pictures = (None if p is None else encode_png(p) for p in beside)
            views.append(PartView(view.light, view.exposure, encode_png(as_picture(own)), *pictures))
        return PartViews(None if found is None else found.board, tuple(views))


@lru_cache(maxsize=MOST_GOOD)
def _board(path: Path, _changed_ns: int) -> TaughtBoard:
    return read_taught_board(path)


# A worker mostly measures boards of one type.
@lru_cache(maxsize=1)
def _models(good: tuple[TaughtBoard, ...]) -> Models:
    return Models(good)


def _in_steps(board_type: BoardType) -> Iterator[list[Component]]:
    """Yield the parts for each step, all of one kind together, the most frequent kind first.

    The contrast of frequent kinds is that with which rare ones are compared.
    """
    kinds: dict[str, list[Component]] = {}
    for part in board_type.components:
        kinds.setdefault(kind_of(part, board_type), []).append(part)
    some: list[Component] = []
    for parts in sorted(kinds.values(), key=len, reverse=True):
        some += parts
        if len(some) >= _STEP_PARTS:
            yield some
            some = []
    if some:
        yield some
