"""Orders: board type and caller's ids for the boards to come; a board keeps its order from the barrier on."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.config import Line, MethodName
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.model import BoardType, Calibration, CameraHead
from vaoi_station.runs.run.reference_store import ReferenceStore, StoredReference
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import ArmedWith, Reason
from vaoi_station.stitching.board.expectation import expectation_of
from vaoi_station.stitching.method import METHODS
from vaoi_station.stitching.work import StitchSetup
from vaoi_station.store import Store


@dataclass(frozen=True)
class Order:
    """One checked request to arm."""

    board_type: BoardType
    board_id: str | None
    job_id: str | None
    setup: StitchSetup
    board_type_digest: str
    calibration_digest: str
    reference: StoredReference | None = None
    """The run against which this order's boards are placed."""
    notes: tuple[Reason, ...] = ()
    """Limitations that do not prevent filming; every run of the order reports them."""
    despite_lost_cameras: bool = False
    """Film boards although a camera is not connected, as the caller allowed."""

    def shown(self, runs_left: int | None) -> ArmedWith:
        """Return the order as the status page shows it."""
        return ArmedWith(
            board_type=self.board_type.name,
            board_id=self.board_id,
            job_id=self.job_id,
            runs_left=runs_left,
            method=self.setup.method,
            reference=self.reference.run if self.reference else None,
        )


@dataclass
class Orders:
    """The order in force, and the one before: a board that was at the barrier first keeps the old one."""

    order: Order | None = None
    runs_left: int | None = None
    since_s: float = field(default=float("-inf"))
    _before: Order | None = None

    def accept(self, order: Order, runs: int | None, now_s: float) -> None:
        """Put an order in force for the boards that come from now on."""
        self._before, self.order = self.order, order
        self.runs_left, self.since_s = runs, now_s

    def take(self, barrier_s: float) -> Order | None:
        """Return the order for a board that interrupted the barrier at `barrier_s`, and count the board."""
        # Compared by time, not by arrival: the report of a board may arrive after the next order was accepted.
        if self.order is None or (barrier_s < self.since_s and self._before is not None):
            return self._before
        # Boards of the earlier order are not counted: the number of runs is that of the present one.
        if self.runs_left is not None:
            self.runs_left = max(self.runs_left - 1, 0)
        return self.order

    def cancel(self, now_s: float) -> None:
        """End the order; a board already at the barrier keeps it."""
        if self.order is not None:
            self._before, self.order, self.runs_left, self.since_s = self.order, None, None, now_s

    @property
    def references(self) -> set[str]:
        """Runs against which boards may still be placed."""
        return {order.reference.run for order in (self.order, self._before) if order and order.reference}

    @property
    def wants_more(self) -> bool:
        """Whether another board is to be filmed."""
        return self.order is not None and self.runs_left != 0

    def shown(self) -> ArmedWith | None:
        """Return the order in force as the status page shows it; None if there is none."""
        return None if self.order is None else self.order.shown(self.runs_left)


class OrderFactory:
    """Makes orders, and refuses what is wrong with a board type on this line before a board comes."""

    def __init__(
        self,
        line: Line,
        calibration: Calibration,
        heads: tuple[CameraHead, ...],
        store: Store,
        references: ReferenceStore,
        method: MethodName = "auto",
    ) -> None:
        """Prepare what all orders of a station share.

        Args:
            line: geometry and speed of the line.
            calibration: in force.
            heads: format of every camera.
            store: keeps the documents that runs refer to.
            references: of the board types.
            method: for board types without one of their own.
        """
        self._line, self._store, self._references, self._method = line, store, references, method
        self._cameras = calibration.cameras(heads)
        self._calibration_digest = store.keep_document("calibration", calibration.model_dump_json(), utc())

    def __call__(self, board_type: BoardType, board_id: str | None, job_id: str | None) -> Order:
        """Make the order for a board type; `StateError` if its method needs a reference that is missing or unusable."""
        method = self._references.method(board_type.name) or self._method
        reference, notes = self._reference(board_type, method)
        setup = StitchSetup(
            cameras=self._cameras,
            conveyor_mm_s=self._line.conveyor_mm_s,
            trigger_period_s=self._line.trigger_period_s,
            board_type=board_type,
            expectation=expectation_of(self._line, board_type),
            method=method,
            reference=reference.reference if reference else None,
        )
        # Runs name their documents by digest: a board type that changes later does not change old results.
        digest = self._store.keep_document("board-type", board_type.model_dump_json(), utc())
        return Order(board_type, board_id, job_id, setup, digest, self._calibration_digest, reference, notes)

    def _reference(
        self, board_type: BoardType, method: MethodName
    ) -> tuple[StoredReference | None, tuple[Reason, ...]]:
        """Return the reference for a board type, or a note with the cause if it has one that does not fit."""
        if not METHODS[method].reference:
            return None, ()
        try:
            reference = self._references.open(board_type)
        except VaoiError as fault:
            if method == "reference":
                raise StateError(fault.message, action=fault.action, code="reference-unusable") from fault
            message = f"Stitched without the reference: {fault.message}"
            return None, (Reason(code="reference-unusable", message=message, action=fault.action),)
        if reference is None and method == "reference":
            raise StateError(
                f"Board type {board_type.name!r} is stitched by its reference, but none was taught.",
                action="Let a board pass with method auto, then teach its run as the reference.",
                code="no-reference",
            )
        return reference, ()
