"""Orders: board type and caller's ids for the next boards. A board keeps the order that was in force at the barrier.

The order in force is stored: after a restart the line is armed again with it, or the reason why not is shown.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, ValidationError

from vaoi_station.acquisition.controller.filming_plan import filming_plan, line_of_board
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.config import MethodName, StationConfig
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Calibration, Reason
from vaoi_station.runs.run.reference_store import ReferenceStore, StoredReference
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import ArmedWith
from vaoi_station.stitching.expectation import expectation_of, refuse_unplaceable
from vaoi_station.stitching.matching.evidence import METHODS
from vaoi_station.stitching.work import StitchSetup
from vaoi_station.store import Store
from vaoi_station.store.documents import KeyedTexts

_KEY = "armed"
_NEVER_S = float("-inf")
_MOST_FORMER = 16
"""Number of former orders that are kept for boards that have interrupted the barrier, but have no pulse yet."""
Passing = Literal["wait", "after", "refuse"]
"""What a request to arm does while a board passes: it waits until the board has left; it returns at once and takes
effect then; it is refused."""


@dataclass(frozen=True)
class Order:
    """One checked request to arm, with everything that is needed to film and stitch its boards."""

    board_type: BoardType
    board_id: str | None
    job_id: str | None
    setup: StitchSetup
    board_type_digest: str
    calibration_digest: str
    filmed_digest: str
    """Digest of what drift checks of one board type have in common (`BoardType.filmed_digest`)."""
    reference: StoredReference | None = None
    """The reference against which boards of this order are placed; None: no reference is used."""
    notes: tuple[Reason, ...] = ()
    """Limitations that do not prevent filming; every run of the order reports them."""
    configuration_digest: str = ""
    despite_lost_cameras: bool = False
    """Whether to film boards although a camera is not connected, as the caller allowed."""
    plan: TriggerPlan | None = None
    """The trigger plan of the board type; None: that of the station."""
    line: Line | None = None
    """The line as the board type needs it; None: as in station.toml."""

    @property
    def draft(self) -> Reason | None:
        """The warning about a board type that was not approved; None if it was."""
        if self.board_type.state != "draft":
            return None
        return Reason(
            code="board-type-draft",
            message=f"Board type {self.board_type.name!r} is a draft: its data were not approved.",
            action="Check positions on a run, then approve the board type.",
        )

    def shown(self, runs_left: int | None) -> ArmedWith:
        """Return the part of the order that `GET station` and the page show."""
        return ArmedWith(
            board_type=self.board_type.name,
            board_id=self.board_id,
            job_id=self.job_id,
            runs_left=runs_left,
            method=self.setup.method,
            reference=self.reference.run if self.reference else None,
        )


class _Doubt(NamedTuple):
    """A board that may have passed without a run."""

    edge_s: float
    """Host time at which the board interrupted the barrier; if it is not known, the earliest possible one."""
    published_s: float
    """Host time at which callers could first know of the board."""
    why: str


class _FormerOrder(NamedTuple):
    """An order that was in force before the present one; None: no order was in force."""

    order: Order | None
    since_s: float


@dataclass
class Orders:
    """The order in force, and those before it, which still apply to boards at the barrier before the change.

    Times are host times by time.monotonic().
    """

    order: Order | None = None
    runs_left: int | None = None
    """Number of boards still to be filmed; None: no limit."""
    since_s: float = _NEVER_S
    taken_since_s: float = _NEVER_S
    """Time since which the order that was taken last has been in force."""
    resumed: bool = False
    """Whether the order was in force before a restart of the station, and no caller has armed since."""
    _former: deque[_FormerOrder] = field(default_factory=lambda: deque(maxlen=_MOST_FORMER))
    """From the oldest to the newest, those that a board may still need whose first pulse was not fired yet."""
    _edge_s: float = _NEVER_S
    """Time at which the latest board that has a run interrupted the barrier."""
    _doubts: deque[_Doubt] = field(default_factory=lambda: deque(maxlen=64))

    def accept(self, order: Order, runs: int | None, now_s: float) -> None:
        """Put an order in force for the boards that interrupt the barrier after `now_s`; `runs` limits their number."""
        self._former.append(_FormerOrder(self.order, self.since_s))
        self.order, self.runs_left, self.since_s, self.resumed = order, runs, now_s, False

    def take(self, barrier_s: float) -> Order | None:
        """Return the order of a board that interrupted the barrier at `barrier_s`, and count the board."""
        self._edge_s = max(self._edge_s, barrier_s)
        # The time at the barrier decides: until the first pulse, orders may be accepted that are for later boards.
        every = [*self._former, _FormerOrder(self.order, self.since_s)]
        latest = max((n for n, one in enumerate(every) if one.since_s <= barrier_s), default=0)
        # A board that came while no order was in force belongs to the order before, else to the next one.
        found = next((n for n in (*range(latest, -1, -1), *range(latest, len(every))) if every[n].order), latest)
        if len(self._former) == _MOST_FORMER and barrier_s < every[0].since_s:
            self.doubt(_NEVER_S, every[found].since_s, "more orders were given while it waited than are kept")
        # Boards come in the order of their edges: no later one needs the orders before this one.
        for _ in range(found):
            self._former.popleft()
        self.taken_since_s = every[found].since_s
        # Only boards of the present order are counted, because `runs_left` belongs to it.
        if found == len(every) - 1 and self.runs_left is not None:
            self.runs_left = max(self.runs_left - 1, 0)
        return every[found].order

    def cancel(self, now_s: float) -> None:
        """End the order in force. A board that interrupted the barrier before `now_s` keeps the order."""
        if self.order is not None:
            self._former.append(_FormerOrder(self.order, self.since_s))
            self.order, self.runs_left, self.since_s = None, None, now_s

    def doubt_since_last(self, now_s: float, why: str) -> None:
        """Record that boards may have passed without a run since the latest board that has one, until now.

        Edges are reported late: a board whose edge is older than `now_s` may still begin its run after this.
        """
        self.doubt(min(self._edge_s, now_s), now_s, why)

    def doubt(self, edge_s: float, published_s: float, why: str) -> None:
        """Record that a board may have passed without a run, and when callers could first know of it."""
        self._doubts.append(_Doubt(edge_s, published_s, why))

    def doubt_of(self, since_s: float, barrier_s: float) -> str | None:
        """Return why the id of an order may belong to another board than the one at `barrier_s`; None if certain."""
        # An order counts boards from the time at which it was accepted, or until which its caller knew all missed
        # boards. A board that passed unnoticed may have been the one for which the order was given.
        why = (d.why for d in reversed(self._doubts) if d.edge_s < barrier_s and since_s <= d.published_s)
        return next(why, None)

    @property
    def present_doubt(self) -> str | None:
        """Why the armed board id may belong to another board than the next; None if certain, or none is armed."""
        if self.order is None or self.order.board_id is None:
            return None
        return self.doubt_of(self.since_s, float("inf"))

    @property
    def references(self) -> set[str]:
        """Ids of the reference runs against which boards may still be placed."""
        every = [self.order, *(former.order for former in self._former)]
        return {order.reference.run for order in every if order and order.reference}

    @property
    def wants_more(self) -> bool:
        """Whether another board is to be filmed for the order in force."""
        return self.order is not None and self.runs_left != 0

    def shown(self) -> ArmedWith | None:
        """Return what `GET station` and the page show of the order in force; None if no order is in force."""
        if self.order is None:
            return None
        shown = self.order.shown(self.runs_left)
        return shown.model_copy(update={"board_id_certain": self.present_doubt is None, "resumed": self.resumed})


class OrderFactory:
    """Makes orders. Board types that cannot be stitched on this line are refused here, before a board comes."""

    def __init__(
        self,
        config: StationConfig,
        calibration: Calibration,
        store: Store,
        references: ReferenceStore,
        lights: tuple[str, ...] = (),
    ) -> None:
        """Prepare orders; `lights` are those of rows without a light program, in turn; empty if not known."""
        self._config, self._lights = config, lights
        self._store, self._references = store, references
        self.use_calibration(calibration)

    def use_calibration(self, calibration: Calibration) -> None:
        """Use another calibration for all orders from now on."""
        self._cameras = calibration.cameras(self._config.heads)
        self._calibration_digest = self._store.keep_document("calibration", calibration.model_dump_json(), utc())

    def __call__(self, board_type: BoardType, board_id: str | None, job_id: str | None) -> Order:
        """Make the order for a board type.

        Raises:
            InputError: the board type cannot be placed, or its lights, speed or lengths do not fit the station.
            StateError: the board type is retired, or the method needs a reference that is missing or unusable.
        """
        if board_type.state == "retired":
            raise StateError(
                f"Board type {board_type.name!r} is retired.",
                action="Arm another board type, or approve this one again.",
                code="board-type-retired",
            )
        # Files in the directory may be older than this rule, or written by hand.
        refuse_unplaceable(board_type, "board type")
        line = line_of_board(self._config, board_type)
        plan = filming_plan(self._config, board_type, [camera.px_per_mm for camera in self._cameras])
        method = self._references.method(board_type.name) or self._config.method
        reference, notes = self._reference(board_type, method)
        setup = StitchSetup(
            cameras=self._cameras,
            conveyor_mm_s=line.conveyor_mm_s,
            trigger_period_s=line.trigger_period_s,
            board_type=board_type,
            expectation=expectation_of(line, board_type),
            method=method,
            reference=reference.reference if reference else None,
            visibility=self._config.visibility,
            lights=tuple(plan.lights) or self._lights,
            channels={name: light.channels for name, light in self._config.controller.lights.items()},
        )
        # Packed here, in the thread of the caller who arms, and not when the first board is filmed.
        _ = setup.packed
        order = Order(
            board_type=board_type,
            board_id=board_id,
            job_id=job_id,
            setup=setup,
            # Runs refer to their documents by digest, so a later change of the board type does not affect old results.
            board_type_digest=self._store.keep_document("board-type", board_type.model_dump_json(), utc()),
            calibration_digest=self._calibration_digest,
            filmed_digest=board_type.filmed_digest(),
            reference=reference,
            notes=notes,
            configuration_digest=self._store.configurations.present,
            plan=plan,
            line=line,
        )
        return replace(order, notes=(*notes, order.draft)) if order.draft else order

    def _reference(
        self, board_type: BoardType, method: MethodName
    ) -> tuple[StoredReference | None, tuple[Reason, ...]]:
        """Return the reference of a board type, or None and why it is not usable; `StateError` if it is needed."""
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


class _Armed(BaseModel):
    """The order in the form in which it is stored."""

    model_config = ConfigDict(frozen=True)

    board_type: str
    board_id: str | None = None
    job_id: str | None = None
    runs: int | None = None
    allow_lost_cameras: bool = False


@dataclass(frozen=True)
class Resumed:
    """The order that was in force before a restart, ready to be armed again, or why it cannot be."""

    order: Order | None
    runs: int | None
    fault: Reason | None = None


class StandingOrder:
    """Stores the order in force in the database. Callers do not wait for the disk."""

    def __init__(self, documents: KeyedTexts) -> None:
        self._documents = documents

    def keep(self, order: Order | None, runs: int | None) -> None:
        """Store an order, with the number of boards still to be filmed for it; None deletes the stored one."""
        if order is None:
            self._documents.set(_KEY, None)
            return
        armed = _Armed(
            board_type=order.board_type.name,
            board_id=order.board_id,
            job_id=order.job_id,
            runs=runs,
            allow_lost_cameras=order.despite_lost_cameras,
        )
        self._documents.set(_KEY, armed.model_dump_json())

    def resume(
        self,
        get_board_type: Callable[[str], BoardType],
        make_order: Callable[[BoardType, str | None, str | None], Order],
    ) -> Resumed | None:
        """Make the order that was in force when the station ended again; None if the line was not armed."""
        document = self._documents.get(_KEY)
        if document is None:
            return None
        try:
            armed = _Armed.model_validate_json(document)
            order = make_order(get_board_type(armed.board_type), armed.board_id, armed.job_id)
        except (ValidationError, VaoiError) as error:
            why, action = "the order cannot be read", "Arm the line."
            if isinstance(error, VaoiError):
                why, action = error.message, f"{error.action} Then arm the line.".strip()
            message = f"The line was armed before the restart and is not armed now: {why}"
            return Resumed(None, None, Reason(code="not-armed-again", message=message, action=action))
        if armed.runs == 0:
            return None
        return Resumed(replace(order, despite_lost_cameras=armed.allow_lost_cameras), armed.runs)
