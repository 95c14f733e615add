"""What the REST service sees of the station: the methods of the coordinator, and the shapes they return.

Every method may be called from any thread.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from vaoi_station.config import MethodName
from vaoi_station.model import BoardType, FrameRecord, Stitch
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus, CameraCalibration, CameraDrift, CameraMoment
from vaoi_station.runs.states.schemas import (
    ArmedWith,
    BayStatus,
    BeltSpeed,
    BoardTypeSummary,
    CameraStatus,
    ComponentSummary,
    EventRecord,
    ImageFormat,
    LeaseStatus,
    ProcessStatus,
    Reason,
    ReferenceStatus,
    Retention,
    RingStatus,
    RunDetail,
    RunSummary,
    StationSnapshot,
    StitchingMethod,
    TaskTiming,
    Timeline,
    Timings,
    VerdictCounts,
    Versions,
)
from vaoi_station.runs.states.tables import RunState, StationState

if TYPE_CHECKING:
    from vaoi_station.rendering import View

__all__ = [
    "ArmedWith",
    "BayStatus",
    "BeltSpeed",
    "BoardTypeSummary",
    "CalibrationStatus",
    "CameraCalibration",
    "CameraDrift",
    "CameraMoment",
    "CameraStatus",
    "ComponentSummary",
    "Coordinator",
    "EventRecord",
    "ImageFormat",
    "LeaseStatus",
    "ProcessStatus",
    "Reason",
    "ReferenceStatus",
    "Retention",
    "RingStatus",
    "RunDetail",
    "RunState",
    "RunSummary",
    "StationSnapshot",
    "StationState",
    "StitchingMethod",
    "TaskTiming",
    "Timeline",
    "Timings",
    "VerdictCounts",
    "Versions",
]


class Coordinator(Protocol):
    """The station as its callers see it; all methods are thread-safe and raise `VaoiError`s only."""

    def snapshot(self) -> StationSnapshot:
        """State, health, memory and versions at this moment."""

    def arm(
        self,
        board_type: str,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
    ) -> StationSnapshot:
        """Film every board from now on (or so many runs); returns once cameras and controller are armed.

        Again while armed: applies to the boards that come from now on. `NotFoundError`: board type nobody
        taught; `BusyError`: all memory is leased, with the holders; `StateError`: a board is passing, or the
        station is faulted; `DeviceError`: a camera is lost (unless that is allowed), or refuses to be armed.
        """

    def disarm(self) -> StationSnapshot:
        """Ignore the barrier; a run under way is finished with what it has. Harmless when idle."""

    def board_types(self) -> tuple[BoardTypeSummary, ...]:
        """All board types, by name; unusable files are listed with their fault."""

    def board_type(self, name: str) -> BoardType:
        """One board type; `NotFoundError` if nobody taught it."""

    def put_board_type(self, board_type: BoardType) -> bool:
        """Teach a board type; True if it is new. Runs keep theirs, an armed line the one it was armed with."""

    def delete_board_type(self, name: str) -> None:
        """Forget a board type; `StateError` while armed with it."""

    def calibration(self) -> CalibrationStatus:
        """The calibration in force, and how the cameras have stood to it in the latest runs."""

    def reference(self, board_type: str) -> ReferenceStatus:
        """The reference of a board type; `NotFoundError` if it has none."""

    def teach_reference(self, board_type: str, run: str) -> bool:
        """Make a finished run the reference of its board type, from the next arming on; True if it had none.

        `NotFoundError`: no such run or board type; `InputError`: the run shows another board type;
        `StateError`: it has no result yet, or not one that is ok; `GoneError`: its frames are gone.
        """

    def forget_reference(self, board_type: str) -> None:
        """Place boards without a reference from the next arming on; `NotFoundError` if there is none."""

    def method(self, board_type: str) -> StitchingMethod:
        """How runs of a board type are stitched."""

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        """Give a board type a way of its own from the next arming on; None: the station's holds again."""

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[RunSummary, ...]:
        """Runs, newest first; `before`: only those older than this id."""

    def run(self, run: str) -> RunDetail:
        """One run, also while it is filmed; `NotFoundError` if there was none of that id."""

    def latest(self) -> RunDetail | None:
        """The run that finished last; None before the first."""

    def next_run(self, after: str | None, timeout_s: float) -> RunDetail | None:
        """The first run that finished after `after` did (None: after this call); None on time-out.

        Following the ids it returns, a caller sees every finished run once.
        """

    def release(self, run: str) -> RunDetail:
        """Give up a finished run's frames; the result stays. `StateError` while it is filmed or stitched."""

    def hold(self, run: str, holder: str, purpose: str) -> LeaseStatus:
        """Keep a run's frames in memory for `lease_s`; the same call again renews. `GoneError` if too late."""

    def let_go(self, run: str, holder: str) -> None:
        """End a hold; harmless if there is none."""

    def stitch(self, run: str) -> Stitch:
        """The result; `StateError` while there is none yet, `NotFoundError` if the run ended without one."""

    def stitch_text(self, run: str) -> str:
        """The same as JSON text."""

    def timeline(self, run: str) -> Timeline:
        """When what happened in a finished run."""

    def frame(
        self, run: str, camera: int, row: int, allow_incomplete: bool = False
    ) -> tuple[NDArray[Any], FrameRecord]:
        """A copy of one frame's pixels, (h, w) uint8 or uint16, and its record.

        `GoneError`: memory was given away; `NotFoundError`: no such frame, or it never arrived;
        `StateError`: it is incomplete and that was not allowed, or not yet settled.
        """

    def components(self, run: str) -> tuple[ComponentSummary, ...]:
        """Components of the board type the run was filmed with, and where they were."""

    def views(self, run: str, ref: str, px_per_mm: float | None = None, min_coverage: float = 0.5) -> tuple[View, ...]:
        """The frames that show a component (address `panel/ref` or `ref`), as temporary images to be rendered."""

    def image(
        self,
        run: str,
        ref: str,
        k: int,
        *,
        px_per_mm: float | None = None,
        format: ImageFormat = "png",
        min_coverage: float = 0.5,
    ) -> bytes:
        """Temporary image k of `views(…)` with the same arguments, rendered and encoded in a worker."""

    def events(self, after: int = 0, timeout_s: float = 0.0, limit: int = 1000) -> tuple[EventRecord, ...]:
        """Events numbered above `after`, oldest first; waits for one if there is none."""
