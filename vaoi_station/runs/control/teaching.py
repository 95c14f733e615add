"""Board types, the references that are kept for them, and the methods by which their runs are stitched."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files.images import Image
from vaoi_station.model import BoardType, Calibration, Reason, Status, Stitch
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.archive.measured_parts import MeasuredParts
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.pictures import FrameAccess
from vaoi_station.runs.run.inbox import Inbox
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import BoardTypeSummary, ReferenceRecord, ReferenceStatus, StitchingMethod
from vaoi_station.stitching.expectation import refuse_unplaceable
from vaoi_station.stitching.recordings.references import (
    CONFIRM,
    awaits_confirmation,
    select_reference_frames,
    with_confirmed_orientation,
    write_reference,
)
from vaoi_station.store import BoardTypeDirectory

Pixels = Callable[[int], Image]
"""Function that copies the frame in a slot of the ring. Raises `GoneError` if the memory was given to a later run."""
_EXPLAINED_S = 30.0
"""Longest wait for the complete result of a run that is taught, s: a reference keeps it for good."""


def board_type_summary(stem: str, board_type: BoardType | None, fault: VaoiError | None) -> BoardTypeSummary:
    """Build one entry of the list, of a file `stem`.json; its board type is None if it cannot be used."""
    if board_type is None:
        assert fault is not None
        return BoardTypeSummary(name=stem, fault=Reason.of(fault))
    return BoardTypeSummary(
        name=board_type.name,
        revision=board_type.revision,
        state=board_type.state or "approved",
        side=board_type.side,
        unit=board_type.unit,
        components=len(board_type.components),
        fiducials=len(board_type.fiducials),
    )


class BoardTypeRequests:
    """The part of the coordinator that serves requests about board types, their references and methods.

    Changes are published as events. Methods may be called from any thread except the coordinator's.
    """

    _inbox: Inbox
    _core: Core
    _frames: FrameAccess
    parts: MeasuredParts

    def __init__(self, directory: BoardTypeDirectory, references: ReferenceStore, parts: Parts) -> None:
        self._parts, self._directory, self._references = parts, directory, references
        self._changing, self._teaching = threading.Lock(), threading.Lock()
        self._summaries: dict[Path, tuple[tuple[int, ...], BoardTypeSummary]] = {}
        """For each file: its modification time, size and inode when it was read, and its entry in the list."""

    def board_types(self) -> tuple[BoardTypeSummary, ...]:
        """Return a summary of every board type, sorted by name. A file that cannot be used is listed with its fault."""
        # A file is read again only if it has changed: reading many large files takes seconds.
        known, found = self._summaries, {}
        for path in self._directory.paths():
            try:
                status = path.stat()
            except FileNotFoundError:
                continue  # The file was deleted meanwhile.
            state = (status.st_mtime_ns, status.st_size, status.st_ino)
            kept = known.get(path)
            if kept is None or kept[0] != state:
                entry = self._directory.entry(path)
                kept = state, board_type_summary(path.stem, entry.board_type, entry.fault)
            found[path] = kept
        self._summaries = found
        return tuple(summary for _, summary in found.values())

    def board_type(self, name: str) -> BoardType:
        """Return the board type with this name; `NotFoundError` if there is none."""
        return self._directory.get(name)

    def put_board_type(self, board_type: BoardType) -> bool:
        """Add or replace a board type, for later runs; return True if the name is new.

        `InputError` if no run could place it.
        """
        return self._put(board_type)

    def _put(self, board_type: BoardType, source: str = "") -> bool:
        refuse_unplaceable(board_type, "body")
        with self._changing:
            new = self._directory.put(board_type)
        ordered = self._inbox.ask(lambda: self._core.line.orders.board_types)
        # Orders keep the board type with which they were given: the CAD data must not change within a batch.
        later = " The change applies from the next arming on." if board_type.name in ordered else ""
        action = "added" if new else "replaced"
        self._parts.events.add("board-type", f"Board type {board_type.name!r} was {action}{source}.{later}")
        return new

    def delete_board_type(self, name: str) -> None:
        """Delete a board type with its reference and method; `StateError` while it is armed or ordered.

        Its good boards come back with it, if it is restored.
        """
        if name in self._inbox.ask(lambda: self._core.line.orders.board_types):
            message = f"The line is armed for board type {name!r}, or orders for it wait."
            raise StateError(message, action="Disarm first, or withdraw these orders.")
        with self._changing:
            self._directory.delete(name)
            self._references.drop(name)
            self._references.set_method(name, None)
            self.parts.set_aside(name)
        self.sweep_references()
        self._parts.events.add("board-type", f"Board type {name!r} was deleted.")

    def reference(self, board_type: str) -> ReferenceStatus:
        """Return the reference of a board type and whether it is usable; `NotFoundError` if there is no reference."""
        known = self.board_type(board_type)
        record, fault = self._references.record(known.name), None
        if record is None:
            raise _no_reference(board_type)
        try:
            self._references.open(known)
        except VaoiError as error:
            fault = Reason.of(error)
        return ReferenceStatus(**record.model_dump(), board_type=known.name, usable=fault is None, fault=fault)

    def teach_reference(self, board_type: str, run: str, *, confirm_orientation: bool = False) -> bool:
        """Make a finished run the reference of its board type; return True if there was no reference before.

        With `confirm_orientation`, a person has confirmed that the board lies as the board type expects it.

        Raises:
            InputError: the run shows another board type, or the board type has changed since the run.
            StateError: the run has no result yet, or its verdict is not ok.
            GoneError: the frames of the run are no longer in memory.
            DeviceError: the disk refuses the files.
        """
        known, store = self.board_type(board_type), self._references
        # The reference keeps the result as it is now.
        finished = self._parts.archive.explained(run, _EXPLAINED_S)
        calibration = self._parts.archive.calibration_of(finished)
        with self._frames.lease(run, "taught as the reference") as bay:
            stitch = with_confirmed_orientation(finished.result) if confirm_orientation else finished.result
            _check(known.name, finished, stitch)
            # One call at a time: two calls for the same run would write to the same directory.
            with self._teaching:
                path = store.path_of(run)
                if not path.exists():
                    _write(path, finished, stitch, calibration, self._frames.copier(bay))
                store.load(run, known)
                new = not store.has(known.name)
                store.keep(known.name, _record_of(path, finished))
                store.open(known)  # It is read now and cached, so that arming does not wait for the disk.
        self.sweep_references()
        self._parts.events.add("reference", f"Run {run} is now the reference of board type {board_type!r}.", run=run)
        return new

    def forget_reference(self, board_type: str) -> None:
        """Remove the reference of a board type; `NotFoundError` if there is no reference."""
        if not self._references.has(self.board_type(board_type).name):
            raise _no_reference(board_type)
        self._references.drop(board_type)
        self.sweep_references()
        self._parts.events.add("reference", f"The reference of board type {board_type!r} was removed.")

    def method(self, board_type: str) -> StitchingMethod:
        """Return the method by which runs of a board type are stitched."""
        own = self._references.method(self.board_type(board_type).name)
        return StitchingMethod(method=own or self._parts.config.method, chosen="board-type" if own else "station")

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        """Set the stitching method of a board type; None selects the station's method."""
        self._references.set_method(self.board_type(board_type).name, method)
        return self.method(board_type)

    def sweep_references(self) -> None:
        """Delete the files of references that are used by no board type, no unfinished run and no order.

        Also called periodically, because orders and runs end later.
        """

        def in_use() -> set[str]:
            under_way = {p.order.reference.run for p in self._core.active.values() if p.order.reference}
            return under_way | self._core.line.orders.references

        with self._teaching:
            self._references.sweep(self._inbox.ask(in_use))


def _no_reference(board_type: str) -> NotFoundError:
    return NotFoundError(
        f"Board type {board_type!r} has no reference.",
        action="Let a board pass, then teach its run as the reference.",
        code="no-reference",
    )


def _check(board_type: str, finished: FinishedRun, stitch: Stitch) -> None:
    detail = finished.detail
    if detail.board_type != board_type:
        raise InputError(
            f"Run {detail.id} shows board type {detail.board_type!r}, not {board_type!r}.",
            action="Teach a run of this board type.",
            code="other-board-type",
        )
    if stitch.status is not Status.OK or stitch.cad_matrix is None:
        raise StateError(
            f"Run {detail.id} is {stitch.status} and cannot be a reference: {'; '.join(stitch.reasons)}.",
            action=CONFIRM if awaits_confirmation(stitch) else "Teach a run whose verdict is ok.",
            code="not-a-reference",
        )


def _write(path: Path, finished: FinishedRun, stitch: Stitch, calibration: Calibration, pixels: Pixels) -> None:
    head = finished.head
    assert head is not None, "a run with a result was filmed"
    slots = {(f.camera, f.row): f.slot for f in finished.detail.frames if f.usable and f.slot is not None}
    chosen = select_reference_frames(stitch, finished.cameras, finished.board_type, slots)
    everything = {(i, j) for i in range(len(head.cameras)) for j in range(head.rows)}
    kept = head.model_copy(update={"missing": tuple(sorted(everything - chosen)), "x_run": finished.detail.id})

    def frames() -> Iterator[tuple[int, int, Image]]:
        for key in sorted(chosen):
            yield *key, pixels(slots[key])

    try:
        write_reference(path, kept, frames(), calibration, finished.board_type, stitch)
    except OSError as error:
        raise DeviceError(
            f"{path}: the reference cannot be written ({error.strerror}).",
            action="Check space and permissions of the data directory.",
        ) from error


def _record_of(path: Path, finished: FinishedRun) -> ReferenceRecord:
    head = finished.head
    assert head is not None
    files = [file for file in path.rglob("*") if file.is_file()]
    return ReferenceRecord(
        run=finished.detail.id,
        taught=utc(),
        calibration=finished.detail.calibration,
        cameras=len(head.cameras),
        rows=head.rows,
        frames=sum(file.parent.name == "frames" for file in files),
        size_bytes=sum(file.stat().st_size for file in files),
        cad_sigma_px=finished.result.quality.get("cad_sigma_px"),
    )
