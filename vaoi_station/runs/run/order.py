"""Orders: board type and caller's ids for boards. Board types that cannot be filmed are refused when they are made."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from vaoi_station.acquisition.controller.filming_plan import filming_plan, line_of_board
from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.config import MethodName, StationConfig
from vaoi_station.errors import InputError, StateError, VaoiError
from vaoi_station.line_config import Line
from vaoi_station.model import BoardType, Calibration, Reason
from vaoi_station.runs.run.reference_store import ReferenceStore, StoredReference
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import ArmedWith, FlipAxis
from vaoi_station.stitching.board.board_plane import turned_by_flip
from vaoi_station.stitching.expectation import expectation_of, refuse_unplaceable
from vaoi_station.stitching.matching.evidence import METHODS
from vaoi_station.stitching.work import StitchSetup
from vaoi_station.store import Store

_MOST_MADE = 8
"""Number of board types whose orders are kept for the next boards."""
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
    skip: tuple[str, ...] = ()
    """Positions of the boards of a panel that are not to be tested."""
    flip: FlipAxis | None = None
    """Axis about which the board was turned over since its other side was filmed, which lay as station.toml states."""

    def for_board(
        self, board_id: str | None, job_id: str | None, skip: tuple[str, ...] = (), flip: FlipAxis | None = None
    ) -> Order:
        """Return the order for another board of its type; InputError: a position to skip does not exist."""
        positions = {str(c.panel): None for c in self.board_type.components if c.panel is not None} if skip else {}
        if wrong := [position for position in skip if position not in positions]:
            known = ", ".join(positions) or "none, it is no panel"
            raise InputError.field(
                "order", "skip", wrong[0], f"positions of board type {self.board_type.name!r}: {known}"
            )
        setup, line = self.setup, self.line
        expected = setup.expectation
        if line is not None and self._turned(self.flip) != self._turned(flip):
            turned = {"rotation_deg": (line.expected_board.rotation_deg + 180) % 360}
            line = line.model_copy(update={"expected_board": line.expected_board.model_copy(update=turned)})
            expected = expectation_of(line, self.board_type)
        if (expected := replace(expected, skipped=skip)) != setup.expectation:
            setup = replace(setup, expectation=expected)
        return replace(self, board_id=board_id, job_id=job_id, skip=skip, flip=flip, setup=setup, line=line)

    def _turned(self, flip: FlipAxis | None) -> bool:
        return flip is not None and turned_by_flip(self.setup.cameras, self.setup.expectation.angle_rad, flip)

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


class _Made(NamedTuple):
    """An order for any board of a type, what it was made of beside the type, and the type as it is stored."""

    of: tuple[object, ...]
    order: Order
    document: str


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
        self._made: dict[str, _Made] = {}
        """The latest orders by board type, if it is filmed as before: neighbours wait while one is made."""
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
        method = self._references.method(board_type.name) or self._config.method
        reference, notes = self._reference(board_type, method)
        used = reference.run if reference else None
        made_of = self._calibration_digest, method, used, notes, self._store.configurations.present
        made = self._made.get(board_type.name)
        if made is None or made.of != made_of or made.order.board_type is not board_type:
            order = self._make(board_type, method, reference, notes)
            made = self._made[board_type.name] = _Made(made_of, order, board_type.model_dump_json())
            for name in list(self._made)[:-_MOST_MADE]:
                self._made.pop(name, None)
        # Runs refer to their documents by digest, so a later change of the board type does not affect old results.
        digest = self._store.keep_document("board-type", made.document, utc())
        return replace(made.order, board_id=board_id, job_id=job_id, board_type_digest=digest)

    def _make(
        self, board_type: BoardType, method: MethodName, reference: StoredReference | None, notes: tuple[Reason, ...]
    ) -> Order:
        # Files in the directory may be older than this rule, or written by hand.
        refuse_unplaceable(board_type, "board type")
        line = line_of_board(self._config, board_type)
        plan = filming_plan(self._config, board_type, [camera.px_per_mm for camera in self._cameras])
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
            board_id=None,
            job_id=None,
            setup=setup,
            board_type_digest="",
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
