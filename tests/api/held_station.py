"""A station for the REST tests: no cameras, but real board types, frames, results and waits."""

from __future__ import annotations

import threading
import time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from tests.api.held.history import HeldHistory, HeldTypes
from tests.api.held.inspection import held_components, held_quality, held_timeline
from tests.api.held.lighting import HeldLighting
from tests.api.held.mosaics import HeldKeptMosaics, HeldMerged, HeldMosaics
from tests.api.held.orders import held_orders
from tests.api.held.pins import HeldPins, HeldStorage
from vaoi_station.api.encoders import ImageFormat, encode_image
from vaoi_station.clamping import Clamped, ClampedRequest, clamp
from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError, GoneError, InternalError, NotFoundError, StateError
from vaoi_station.files.results import stitch_text
from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.model import BoardType, FrameRecord, Reason, Status, Stitch, Verdict
from vaoi_station.rendering import (
    ChosenImages,
    FrameFacts,
    ImageRequest,
    ViewCalculator,
    choose_all,
    measure,
    render_chosen,
)
from vaoi_station.runs.archive.component_views import filmed_board
from vaoi_station.runs.archive.finished_runs import FinishedRun, RunFigures
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import (
    ArmedWith,
    BeltSpeed,
    BoardTypeSummary,
    CalibrationStatus,
    CameraCalibration,
    CameraDrift,
    CameraMoment,
    CameraPtpStatus,
    CameraRecoveryStatus,
    CameraStatus,
    ComponentSummary,
    ContactsStatus,
    EventRecord,
    LeaseStatus,
    ProcessStatus,
    ReferenceStatus,
    Retention,
    RingStatus,
    RunDetail,
    RunSummary,
    StationSnapshot,
    StitchingMethod,
    Timeline,
    Timings,
    VerdictCounts,
    Versions,
)
from vaoi_station.runs.states.schemas import ImageFormat as Rendered
from vaoi_station.runs.states.tables import RunState, StationState

CAMERAS, ROWS, HEIGHT, WIDTH, PX_PER_MM = 3, 4, 240, 320, 8.0
VERSIONS = Versions(station="0.1.0", opencv=cv2.__version__, python="3")
BOARD = {
    "name": "demo-board",
    "outline": [[0, 0], [60, 40]],
    "fiducials": [{"name": "F1", "x": 3, "y": 3, "diameter": 1}, {"name": "F2", "x": 57, "y": 37, "diameter": 1}],
    "components": [
        {"ref": "U1", "center": [20, 20], "width": 10, "height": 8},
        {"ref": "R1", "center": [30, 12], "width": 2, "height": 1.2, "rotation": 90},
        {"ref": "R1", "center": [50, 12], "width": 2, "height": 1.2, "panel": 2},
    ],
}
NOW = "2026-01-01T12:00:00.000Z"


class HeldStation(StationCoordinator):
    """A coordinator without processes: it overrides every method that the service calls; `film` makes a run."""

    def __init__(self) -> None:
        self._news = threading.Condition()
        self.state = StationState.IDLE
        self.armed: ArmedWith | None = None
        self.reasons, self.warnings, self.held_back = [tuple[Reason, ...]()] * 3
        self.lost: tuple[int, ...] = ()
        self.recovering: dict[int, CameraRecoveryStatus] = {}
        self.ptp: dict[int, CameraPtpStatus] = {}
        self.balances_colours = False
        self.despite_lost = False  # whether the order accepts boards without lost cameras
        self.next_try: str | None = None
        self.types = HeldTypes({"demo-board": BoardType.model_validate(BOARD)})
        self.board_type_history = HeldHistory(self.types)  # type: ignore[assignment]
        self.log, self.filmed = list[EventRecord](), dict[str, RunDetail]()
        self.pixels: dict[tuple[str, int, int], NDArray[np.uint8]] = {}
        self.holders: dict[tuple[str, str], LeaseStatus] = {}
        self.references, self.methods = dict[str, ReferenceStatus](), dict[str, MethodName]()
        self.kept, self.storage = HeldPins(self), HeldStorage(self)  # type: ignore[assignment]
        self.broken = self.closed = False
        self.contacts_shown: ContactsStatus | None = None
        self.lights: tuple[str, ...] = ()
        self.orders = held_orders(self.board_type)
        self.lighting = HeldLighting(self)  # type: ignore[assignment]
        self.merged = HeldMerged(self)  # type: ignore[assignment]
        self.mosaics = HeldMosaics(self)
        self.kept.mosaics = HeldKeptMosaics(self)  # type: ignore[assignment]
        matrix = np.array([[PX_PER_MM, 0, 0], [0, -PX_PER_MM, 320], [0, 0, 1]])
        n = Projective(matrix, System.IMAGE, System.ROW)
        self.cameras = tuple(Camera(WIDTH, HEIGHT, n, Lens((0.0, 0.0), 1.0), 400.0) for _ in range(CAMERAS))

    # what happens to it

    def publish(self, kind: str, message: str = "", **fields: Any) -> None:
        with self._news:
            self.log.append(EventRecord(number=len(self.log) + 1, time=utc(), kind=kind, message=message, **fields))
            self._news.notify_all()

    def film(
        self,
        *,
        verdict: Status = Status.OK,
        board_id: str | None = None,
        finish: bool = True,
        board_type: str = "demo-board",
    ) -> str:
        """One board passes: the frame (0, 1) comes with holes, (1, 2) not at all."""
        run = f"r{len(self.filmed) + 1:06d}"
        random = np.random.default_rng(len(self.filmed))
        frames = []
        for camera in range(CAMERAS):
            for row in range(ROWS):
                lost = {(0, 1): Verdict.INCOMPLETE, (1, 2): Verdict.MISSING}.get((camera, row), Verdict.OK)
                lit = {"exposure_us": 100.0 * (row + 1), "gain": 2.0}
                taken: Any = {**lit, "light": self.lights[row % 2]} if self.lights else {}
                cause = "" if lost == "ok" else "cable"
                frames.append(FrameRecord(camera=camera, row=row, verdict=lost, cause=cause, **taken))
                self.pixels[run, camera, row] = _scene(random, camera, row)
        detail = RunDetail(
            id=run, board_type=board_type, board_id=board_id, job_id=None,
            state=RunState.STITCHING, verdict=None, started=utc(), finished=None, rows=ROWS, cameras=CAMERAS,
            counts=VerdictCounts(ok=CAMERAS * ROWS - 2, incomplete=1, missing=1), reasons=(), belt=None,
            timings=None, frames_available=True, frames=tuple(frames), ended="clear", strays=0,
            software=VERSIONS, calibration="c0ffee",
        )  # fmt: skip
        self.filmed[run] = detail
        self.publish("run", f"Run {run} is being stitched.", run=run, state="stitching")
        if finish:
            self.finish(run, verdict)
        return run

    def finish(self, run: str, verdict: Status = Status.OK, reasons: tuple[Reason, ...] = ()) -> None:
        state = {Status.OK: RunState.READY, Status.DEGRADED: RunState.DEGRADED}.get(verdict, RunState.FAILED)
        belt = BeltSpeed(nominal_mm_s=(100, 0), measured_mm_s=(100.5, 0), ratio=1.005)
        timings = Timings(
            filming_s=1.2, ready_after_last_frame_ms=80, links_ms=300, conclude_ms=40, links=30, links_while_filming=27
        )
        ended = {"finished": utc(), "belt": belt, "timings": timings, "reasons": reasons}
        self.filmed[run] = self.filmed[run].model_copy(update={"state": state, "verdict": verdict, **ended})
        self.publish("run", f"Run {run} is {state}.", run=run, state=str(state))

    def fault(self, code: str, message: str, action: str) -> None:
        self.state, self.reasons = StationState.FAULTED, (Reason(code=code, message=message, action=action),)
        self.publish("station", message, state="faulted", code=code, action=action)

    def close(self) -> None:
        with self._news:
            self.closed = True
            self._news.notify_all()

    faults = staticmethod(tuple)

    def snapshot(self) -> StationSnapshot:
        if self.broken:
            raise RuntimeError("a secret path /etc/passwd")
        done, held = self._finished(), (*(() if self.despite_lost else self._lost_cameras()), *self.held_back)
        camera = [
            CameraStatus(
                camera=i,
                name=f"cam{i}",
                connected=i not in self.lost,
                recovery=self.recovering.get(i),
                ptp=self.ptp.get(i),
                lost_since=NOW if i in self.lost else None,
                address=f"10.1.0.{i}",
                link="switch A",
            )
            for i in range(CAMERAS)
        ]
        ring = RingStatus(path="ring", size_bytes=1, bays=(), leases=())
        worker = ProcessStatus(name="worker 0", pid=1, alive=True, restarts=0, heartbeat_age_s=0.1)
        acquisition = ProcessStatus(
            name="acquisition", pid=None, alive=False, restarts=1, heartbeat_age_s=None, next_try=self.next_try
        )
        return StationSnapshot(
            name="test", state=self.state, since=NOW, reasons=self.reasons,
            warnings=self.warnings, set_aside=self.storage.set_aside(),
            armed_with=self.armed, cameras=tuple(camera), all_cameras_ready=not self.lost,
            line_held=held, controller="ok", line_ready=self.state == "armed" and not held,
            processes=(acquisition, worker), ring=ring, versions=VERSIONS,
            retention=Retention(runs_in_memory=3, lease_s=600, frames="a while", results="always", events="always"),
            last_run=done[-1].id if done else None, filming=None, last_event=len(self.log), boards_missed=0,
        )  # fmt: skip

    def lose(self, *cameras: int) -> None:
        """Cameras that are not ready from now on."""
        self.lost = cameras
        self.reasons = self._lost_cameras()
        self.publish("camera", "Cameras were lost, or are back.")

    def _lost_cameras(self) -> tuple[Reason, ...]:
        text = "Camera cam{} is not connected."
        return tuple(Reason(code="camera-lost", message=text.format(k), action="Check its cable.") for k in self.lost)

    def contacts(self) -> ContactsStatus | None:
        return self.contacts_shown

    def take_board_out(self, board: str) -> None:
        shown = self.contacts_shown
        assert shown is not None
        self.contacts_shown = shown.model_copy(update={"boards": tuple(b for b in shown.boards if b.name != board)})

    def arm(
        self,
        board_type: str | None,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
        passing: Passing = "wait",
    ) -> StationSnapshot:
        if board_type is None:
            self.state = StationState.ARMED
            return self.snapshot()
        self.board_type(board_type)
        if self.lost and not allow_lost_cameras:
            action = "Check its cable. To film boards without it, arm with allow_lost_cameras."
            raise DeviceError("The array is not complete.", action=action, code="camera-lost")
        if self.state == StationState.FILMING and passing == "refuse":
            raise StateError("A board is passing.", action="Wait until it has left, then arm again.")
        self.despite_lost = allow_lost_cameras
        self.armed = ArmedWith(board_type=board_type, board_id=board_id, job_id=job_id, runs_left=runs)
        self.state = StationState.ARMED
        self.publish("station", "Armed.", state="armed")
        return self.snapshot()

    def disarm(self) -> StationSnapshot:
        self.state, self.armed = StationState.IDLE, None
        self.publish("station", "Idle.", state="idle")
        return self.snapshot()

    def require_disarmed(self) -> None:
        if self.armed is not None:
            raise StateError("The line is armed; nothing was changed.", code="line-armed")

    def board_types(self) -> tuple[BoardTypeSummary, ...]:
        return tuple(BoardTypeSummary(name=n, components=len(t.components)) for n, t in sorted(self.types.items()))

    def board_type(self, name: str) -> BoardType:
        if name in self.types:
            return self.types[name]
        raise NotFoundError(f"There is no board type {name!r}.", action="Teach it.", code="unknown-board-type")

    def put_board_type(self, board_type: BoardType) -> bool:
        known, self.types[board_type.name] = board_type.name in self.types, board_type
        return not known

    def delete_board_type(self, name: str) -> None:
        self.board_type(name)
        if self.armed and self.armed.board_type == name:
            raise StateError("The station is armed with it.")
        del self.types[name]

    def calibration(self) -> CalibrationStatus:
        moment = CameraMoment(
            run="r000001", time=NOW, x_px=0.01, y_px=9.4, turn_px=0.0, sigma_px=0.02, rms_px=9.1, links=80, fiducials=2
        )
        drift = CameraDrift(size_px=9.4, x_px=0.0, y_px=9.4, turn_px=0.0, since_run="r000001", since=NOW, runs=2)
        drifted = CameraCalibration(camera=1, name="cam1", state="drifted", drift=drift, history=(moment,))
        still = [CameraCalibration(camera=i, name=f"cam{i}", state="steady") for i in (0, 2)]
        return CalibrationStatus(digest="c0ffee", created=NOW, runs=2, cameras=(still[0], drifted, still[1]))

    def drift(self) -> None:
        """A camera was knocked: the station films on, and says so."""
        message = "Camera cam1 is displaced by 9.40 px from its calibration."
        self.warnings = (Reason(code="calibration-drift", message=message, action="Call the engineer."),)
        self.publish("trouble", message, code="calibration-drift")

    def reference(self, board_type: str) -> ReferenceStatus:
        self.board_type(board_type)
        if board_type not in self.references:
            raise NotFoundError(f"Board type {board_type!r} has no reference.", code="no-reference")
        return self.references[board_type]

    def teach_reference(self, board_type: str, run: str, *, confirm_orientation: bool = False) -> bool:
        self.board_type(board_type)
        detail = self.run(run)
        if detail.verdict != Status.OK:
            raise StateError(f"Run {run} is {detail.verdict}.", code="not-a-reference")
        if not detail.frames_available:
            raise GoneError(f"The frames of run {run} were released.", code="frames-gone")
        new = board_type not in self.references
        self.references[board_type] = ReferenceStatus(
            run=run, taught=NOW, calibration="c0ffee", cameras=CAMERAS, rows=ROWS, frames=CAMERAS * ROWS,
            size_bytes=1000, cad_sigma_px=0.01, board_type=board_type, usable=True,
        )  # fmt: skip
        return new

    def forget_reference(self, board_type: str) -> None:
        self.reference(board_type)
        del self.references[board_type]

    def method(self, board_type: str) -> StitchingMethod:
        self.board_type(board_type)
        own = self.methods.get(board_type)
        return StitchingMethod(method=own or "auto", chosen="board-type" if own else "station")

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        self.board_type(board_type)
        self.methods.pop(board_type, None)
        if method is not None:
            self.methods[board_type] = method
        return self.method(board_type)

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[RunSummary, ...]:
        older = [
            r for r in sorted(self.filmed.values(), key=lambda r: r.id, reverse=True) if not before or r.id < before
        ]
        keep = set(RunSummary.model_fields)
        return tuple(RunSummary(**{k: v for k, v in r if k in keep}) for r in older[:limit])

    def run(self, run: str) -> RunDetail:
        if run not in self.filmed:
            raise NotFoundError(f"There is no run {run!r}.", code="unknown-run")
        return self.filmed[run]

    def camera_serials(self, run: str) -> tuple[str | None, ...]:
        return ()

    def run_figures(self) -> RunFigures:
        return RunFigures({"ok": 2, "degraded": 1}, {"ok": 30}, [0, 2, 1, *[0] * 8], 0.4)

    def latest(self) -> RunDetail | None:
        return next(reversed(self._finished()), None)

    def next_run(self, after: str | None, timeout_s: float) -> RunDetail | None:
        if timeout_s > 0 or after is None:
            raise InternalError("the REST service waits by itself, without a thread")
        self.run(after)
        return next((r for r in self._finished() if r.id > after), None)

    def release(self, run: str, holder: str | None = None) -> RunDetail:
        detail = self.run(run).model_copy(update={"state": RunState.RELEASED, "frames_available": False})
        self.filmed[run] = detail
        self.publish("run", f"Run {run} is released.", run=run, state="released")
        return detail

    def hold(self, run: str, holder: str, purpose: str) -> LeaseStatus:
        self.run(run)
        lease = LeaseStatus(run=run, holder=holder, purpose=purpose, expires_in_s=600)
        self.holders[run, holder] = lease
        return lease

    def end_hold(self, run: str, holder: str) -> None:
        self.holders.pop((run, holder), None)

    def stitch(self, run: str) -> Stitch:
        if self.run(run).verdict is None:
            raise StateError(f"Run {run} is still being stitched.", action="Ask again in a moment.")
        m = self.cameras[0].image_from_row.matrix
        motion = [np.array([[1, 0, -5.0 * j], [0, 1, 0], [0, 0, 1]]) for j in range(ROWS)]
        images = tuple(tuple(None if (i, j) == (1, 2) else m @ d for j, d in enumerate(motion)) for i in range(CAMERAS))
        bottom = self.types[self.run(run).board_type].side == "bottom"
        c = np.array([[-1.0, 0, 60], [0, 1, 0], [0, 0, 1]]) if bottom else np.eye(3)
        return Stitch(
            method="held", image_matrices=images, cad_matrix=c, row_motion=tuple(motion), status=Status.OK,
            quality=held_quality(CAMERAS, ROWS),
        )  # fmt: skip

    def stitch_text(self, run: str) -> str:
        return stitch_text(self.stitch(run))

    def finished(self, run: str) -> FinishedRun:
        found: FinishedRun = self.mosaics._archive.get(run)
        return found

    def clamped(self, run: str, request: ClampedRequest) -> Clamped:
        return clamp(filmed_board(self.mosaics._archive.explained(run), self.heights.known(run)), request)

    def is_complete(self, run: str) -> bool:
        return "later" not in self.stitch(run).quality

    def timeline(self, run: str) -> Timeline:
        return held_timeline(CAMERAS, ROWS, self.run(run).verdict is not None)

    def frame(
        self, run: str, camera: int, row: int, allow_incomplete: bool = False
    ) -> tuple[NDArray[Any], FrameRecord]:
        detail = self.run(run)
        record = next((r for r in detail.frames if (r.camera, r.row) == (camera, row)), None)
        if record is None or record.verdict == Verdict.MISSING:
            raise NotFoundError(f"Frame ({camera}, {row}) of run {run} never arrived.")
        if not detail.frames_available:
            raise GoneError(f"The frames of run {run} were released.")
        if record.verdict == Verdict.INCOMPLETE and not allow_incomplete:
            raise StateError(f"Frame ({camera}, {row}) has holes.", action="Ask with incomplete=show.")
        return self.pixels[run, camera, row].copy(), record

    def components(self, run: str) -> tuple[ComponentSummary, ...]:
        unseen = {u.address for u in self.run(run).unseen}
        return held_components(self.types[self.run(run).board_type], unseen, held_quality(CAMERAS, ROWS))

    def images(self, run: str, ref: str, wanted: ImageRequest = ImageRequest()) -> ChosenImages:  # noqa: B008
        board_type, stitch, frames = self.types[self.run(run).board_type], self.stitch(run), self.run(run).frames
        component = board_type.component(ref)
        if component is None:
            raise NotFoundError(f"There is no component {ref!r}.", code="unknown-component")
        whole = {(r.camera, r.row) for r in frames if r.verdict == Verdict.OK}
        facts = {(r.camera, r.row): FrameFacts(r.exposure_us, r.gain, r.light, 0.1 * r.row) for r in frames}
        return choose_all(
            ViewCalculator(board_type, stitch, self.cameras),
            [component],
            (board_type, stitch),
            (whole, facts),
            wanted,
            lambda view: measure(view, self.pixels[run, view.camera, view.row]),
        )[0]

    def image(
        self,
        run: str,
        ref: str,
        k: int,
        wanted: ImageRequest = ImageRequest(),  # noqa: B008
        *,
        format: Rendered = "png",
    ) -> bytes:
        chosen = self.images(run, ref, wanted).chosen
        if k >= len(chosen):
            raise NotFoundError(f"{ref} has {len(chosen)} images; there is no image {k}.")
        views = [s.view for s in (chosen[k], chosen[k].minus) if s is not None]
        pixels = [self.frame(run, view.camera, view.row)[0] for view in views]
        return encode_image(render_chosen(chosen[k], *pixels), ImageFormat(format))[0]

    def events(self, after: int = 0, timeout_s: float = 0.0, limit: int = 1000) -> tuple[EventRecord, ...]:
        until = time.monotonic() + timeout_s
        with self._news:
            while len(self.log) <= after and not self.closed and (left := until - time.monotonic()) > 0:
                self._news.wait(left)
            return tuple(self.log[after : after + limit])

    def _finished(self) -> list[RunDetail]:
        return [r for _, r in sorted(self.filmed.items()) if r.verdict is not None]


def _scene(random: np.random.Generator, camera: int, row: int) -> NDArray[np.uint8]:
    """A grey frame with something to recognise: noise, a bright square, its camera and row."""
    image = random.integers(40, 90, (HEIGHT, WIDTH), dtype=np.uint8)
    image[80:160, 100:200] = 200
    cv2.putText(image, f"{camera}/{row}", (110, 135), cv2.FONT_HERSHEY_SIMPLEX, 1.2, 20, 2)
    return image
