"""What a board is filmed for: the board type and the caller's ids, fixed from the barrier on."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.config import Line
from vaoi_station.model import BoardType, Calibration, CameraHead
from vaoi_station.runs.moments import utc
from vaoi_station.runs.shapes import ArmedWith
from vaoi_station.stitching.expectation import expectation_of
from vaoi_station.stitching.work import Setup
from vaoi_station.store import Store


@dataclass(frozen=True)
class Order:
    """An accepted `arm`."""

    board_type: BoardType
    board_id: str | None
    job_id: str | None
    setup: Setup
    board_type_digest: str
    calibration_digest: str

    def shown(self, runs_left: int | None) -> ArmedWith:
        """As a status page shows it."""
        return ArmedWith(
            board_type=self.board_type.name, board_id=self.board_id, job_id=self.job_id, runs_left=runs_left
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
    def wants_more(self) -> bool:
        """Whether another board is to be filmed."""
        return self.order is not None and self.runs_left != 0

    def shown(self) -> ArmedWith | None:
        """As a status page shows it; None while nothing is ordered."""
        return None if self.order is None else self.order.shown(self.runs_left)


class OrderDesk:
    """Makes orders: everything that can be wrong with a board type on this line is found before a board comes."""

    def __init__(self, line: Line, calibration: Calibration, heads: tuple[CameraHead, ...], store: Store) -> None:
        self._line, self._store = line, store
        self._cameras = calibration.cameras(heads)
        self._calibration_digest = store.keep_document("calibration", calibration.model_dump_json(), utc())

    def __call__(self, board_type: BoardType, board_id: str | None, job_id: str | None) -> Order:
        """The order for boards of a type."""
        setup = Setup(
            cameras=self._cameras,
            conveyor_mm_s=self._line.conveyor_mm_s,
            trigger_period_s=self._line.trigger_period_s,
            board_type=board_type,
            expectation=expectation_of(self._line, board_type),
        )
        digest = self._store.keep_document("board-type", board_type.model_dump_json(), utc())
        return Order(board_type, board_id, job_id, setup, digest, self._calibration_digest)
