"""What is taught: board types as they are listed, and finished runs that become the reference of their board type."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files.images import Image
from vaoi_station.model import BoardType, Calibration, Status, Verdict
from vaoi_station.runs.archive.finished_runs import Dossier
from vaoi_station.runs.run.reference_store import ReferenceShelf
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import BoardTypeSummary, Reason, ReferenceRecord, ReferenceStatus, StitchingMethod
from vaoi_station.stitching.recordings.reference_directory import write_reference
from vaoi_station.stitching.recordings.reference_frames import select_reference_frames

Pixels = Callable[[int], Image]
"""A copy of the frame in a slot of the ring; raises `GoneError` when its memory goes."""


def listed(stem: str, board_type: BoardType | None, fault: VaoiError | None) -> BoardTypeSummary:
    """One entry of the list of board types; of a file that cannot be used (`board_type` None) its fault."""
    if board_type is None:
        assert fault is not None
        return BoardTypeSummary(name=stem, fault=Reason.of(fault))
    return BoardTypeSummary(
        name=board_type.name,
        side=board_type.side,
        unit=board_type.unit,
        components=len(board_type.components),
        fiducials=len(board_type.fiducials),
    )


class Teaching:
    """What the coordinator answers about references and methods."""

    def __init__(self, shelf: ReferenceShelf, method: MethodName) -> None:
        """`method`: of the station."""
        self._shelf, self._method = shelf, method
        self._one_at_a_time = threading.Lock()

    def status(self, board_type: BoardType) -> ReferenceStatus:
        """The reference of a board type, and whether it can be used; `NotFoundError` if it has none."""
        record = self._shelf.record(board_type.name)
        if record is None:
            raise _none(board_type.name)
        fault = None
        try:
            self._shelf.open(board_type)
        except VaoiError as error:
            fault = Reason.of(error)
        return ReferenceStatus(**record.model_dump(), board_type=board_type.name, usable=fault is None, fault=fault)

    def teach(self, board_type: BoardType, dossier: Dossier, calibration: Calibration, pixels: Pixels) -> bool:
        """Make a finished run the reference of its board type; True if it had none.

        Args:
            board_type: as it is taught now.
            dossier: of the run.
            calibration: the run was stitched with.
            pixels: its frames.

        Raises:
            InputError: the run shows another board type, or the board type has changed since.
            StateError: its result is not good enough to place others against.
            DeviceError: the disk refuses it.
        """
        _check(board_type.name, dossier)
        run = dossier.detail.id
        with self._one_at_a_time:
            path = self._shelf.path_of(run)
            if not path.exists():
                _write(path, dossier, calibration, pixels)
            self._shelf.look_at(run, board_type)
            new = self._shelf.record(board_type.name) is None
            self._shelf.keep(board_type.name, _record_of(path, dossier))
            self._shelf.open(board_type)  # from the disk now, so that arming need not
        return new

    def forget(self, board_type: str) -> None:
        """A board type has no reference any more; `NotFoundError` if it had none."""
        if self._shelf.record(board_type) is None:
            raise _none(board_type)
        self._shelf.drop(board_type)

    def method(self, board_type: str) -> StitchingMethod:
        """How runs of a board type are stitched."""
        own = self._shelf.method(board_type)
        return StitchingMethod(method=own or self._method, chosen="board-type" if own else "station")

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        """Give a board type a way of its own; None: the station's holds again."""
        self._shelf.set_method(board_type, method)
        return self.method(board_type)

    def board_type_forgotten(self, board_type: str) -> None:
        """What belongs to a board type goes with it."""
        self._shelf.drop(board_type)
        self._shelf.set_method(board_type, None)

    def sweep(self, in_use: set[str]) -> None:
        """Remove what no board type names and no run (of these ids) is placed against."""
        with self._one_at_a_time:
            self._shelf.sweep(in_use)


def _none(board_type: str) -> NotFoundError:
    return NotFoundError(
        f"Board type {board_type!r} has no reference.",
        action="Let a board pass, then teach its run as the reference.",
        code="no-reference",
    )


def _check(board_type: str, dossier: Dossier) -> None:
    detail = dossier.detail
    if detail.board_type != board_type:
        raise InputError(
            f"Run {detail.id} shows board type {detail.board_type!r}, not {board_type!r}.",
            action="Teach a run of this board type.",
            code="other-board-type",
        )
    stitch = dossier.result
    if stitch.status is not Status.OK or stitch.cad_matrix is None:
        raise StateError(
            f"Run {detail.id} is {stitch.status} and cannot be a reference: {'; '.join(stitch.reasons)}.",
            action="Teach a run whose verdict is ok.",
            code="not-a-reference",
        )


def _write(path: Path, dossier: Dossier, calibration: Calibration, pixels: Pixels) -> None:
    head = dossier.head
    assert head is not None, "a run with a result was filmed"
    slots = {(f.camera, f.row): f.slot for f in dossier.detail.frames if f.verdict is Verdict.OK and f.slot is not None}
    chosen = select_reference_frames(dossier.result, dossier.cameras, dossier.board_type, slots)
    everything = {(i, j) for i in range(len(head.cameras)) for j in range(head.rows)}
    kept = head.model_copy(update={"missing": tuple(sorted(everything - chosen)), "x_run": dossier.detail.id})

    def frames() -> Iterator[tuple[int, int, Image]]:
        for key in sorted(chosen):
            yield *key, pixels(slots[key])

    try:
        write_reference(path, kept, frames(), calibration, dossier.board_type, dossier.result)
    except OSError as error:
        raise DeviceError(
            f"{path}: the reference cannot be written ({error.strerror}).",
            action="Check space and permissions of the data directory.",
        ) from error


def _record_of(path: Path, dossier: Dossier) -> ReferenceRecord:
    head = dossier.head
    assert head is not None
    files = [file for file in path.rglob("*") if file.is_file()]
    return ReferenceRecord(
        run=dossier.detail.id,
        taught=utc(),
        calibration=dossier.detail.calibration,
        cameras=len(head.cameras),
        rows=head.rows,
        frames=sum(file.parent.name == "frames" for file in files),
        size_bytes=sum(file.stat().st_size for file in files),
        cad_sigma_px=dossier.result.quality.get("cad_sigma_px"),
    )
