"""What a board is filmed for: the board type and the caller's ids, fixed from the barrier on."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.config import Line, MethodName
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.model import BoardType, Calibration, CameraHead
from vaoi_station.runs.run.reference_store import ReferenceShelf, Shelved
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import ArmedWith, Reason
from vaoi_station.stitching.board.expectation import expectation_of
from vaoi_station.stitching.method import METHODS
from vaoi_station.stitching.work import StitchSetup
from vaoi_station.store import Store


@dataclass(frozen=True)
class Order:
    """An accepted `arm`."""

    board_type: BoardType
    board_id: str | None
    job_id: str | None
    setup: StitchSetup
    board_type_digest: str
    calibration_digest: str
    reference: Shelved | None = None
    """The run that this order's boards are placed against."""
    notes: tuple[Reason, ...] = ()
    """What is not as one might expect, though boards can be filmed; told with every run."""
    despite_lost_cameras: bool = False
    """Boards are filmed though a camera is not ready: whoever armed wanted it so."""

    def shown(self, runs_left: int | None) -> ArmedWith:
        """As a status page shows it."""
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
    """The order in force, and the one before: a board that was under the barrier first is still the old one's."""

    order: Order | None = None
    runs_left: int | None = None
    since_s: float = field(default=float("-inf"))
    _before: Order | None = None

    def accept(self, order: Order, runs: int | None, now_s: float) -> None:
        """A new order for the boards that come from now on."""
        self._before, self.order = self.order, order
        self.runs_left, self.since_s = runs, now_s

    def take(self, barrier_s: float) -> Order | None:
        """The order for a board that interrupted the barrier then; counts it."""
        if self.order is None or (barrier_s < self.since_s and self._before is not None):
            return self._before
        if self.runs_left is not None:
            self.runs_left = max(self.runs_left - 1, 0)
        return self.order

    def cancel(self, now_s: float) -> None:
        """No more boards are wanted; one that is under the barrier already is still the last order's."""
        if self.order is not None:
            self._before, self.order, self.runs_left, self.since_s = self.order, None, None, now_s

    @property
    def references(self) -> set[str]:
        """Runs that boards may still be placed against."""
        return {order.reference.run for order in (self.order, self._before) if order and order.reference}

    @property
    def wants_more(self) -> bool:
        """Whether another board is to be filmed."""
        return self.order is not None and self.runs_left != 0

    def shown(self) -> ArmedWith | None:
        """As a status page shows it; None while nothing is ordered."""
        return None if self.order is None else self.order.shown(self.runs_left)


class OrderDesk:
    """Makes orders: everything that can be wrong with a board type on this line is found before a board comes."""

    def __init__(
        self,
        line: Line,
        calibration: Calibration,
        heads: tuple[CameraHead, ...],
        store: Store,
        shelf: ReferenceShelf,
        method: MethodName = "auto",
    ) -> None:
        """`method`: how board types are stitched that have no way of their own."""
        self._line, self._store, self._shelf, self._method = line, store, shelf, method
        self._cameras = calibration.cameras(heads)
        self._calibration_digest = store.keep_document("calibration", calibration.model_dump_json(), utc())

    def __call__(self, board_type: BoardType, board_id: str | None, job_id: str | None) -> Order:
        """The order for boards of a type; `StateError` if its way to stitch needs a reference that cannot be had."""
        method = self._shelf.method(board_type.name) or self._method
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
        digest = self._store.keep_document("board-type", board_type.model_dump_json(), utc())
        return Order(board_type, board_id, job_id, setup, digest, self._calibration_digest, reference, notes)

    def _reference(self, board_type: BoardType, method: MethodName) -> tuple[Shelved | None, tuple[Reason, ...]]:
        """The reference to place boards against; one that does not fit is left out, with a note that says why."""
        if not METHODS[method].reference:
            return None, ()
        try:
            reference = self._shelf.open(board_type)
        except VaoiError as fault:
            if method == "reference":
                raise StateError(fault.message, action=fault.action, code="reference-unusable") from fault
            message = f"Stitched without its reference: {fault.message}"
            return None, (Reason(code="reference-unusable", message=message, action=fault.action),)
        if reference is None and method == "reference":
            raise StateError(
                f"Board type {board_type.name!r} is stitched by its reference, but none was taught.",
                action="Let a board pass with method auto, then teach its run as the reference.",
                code="no-reference",
            )
        return reference, ()
