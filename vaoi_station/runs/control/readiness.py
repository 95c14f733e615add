"""Readiness of line and cameras: why the next board must wait, and the refusal to arm the line without all cameras.

A camera that is not connected is absent, in use by another program, or refuses its settings. Without its frames, no
board is seen in the camera's view. The operator must know this before the batch starts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.acquisition.controller.interface import Permit
from vaoi_station.acquisition.process.messages import Health, PermitBoard
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.model import Reason
from vaoi_station.runs.control.reasons import sentence
from vaoi_station.runs.states.tables import StationState
from vaoi_station.store.storage_trouble import PASSING

CODE = "camera-lost"
NOT_READY = PASSING | {CODE, "workers-starting", "ring-full", "not-armed-again", "no-calibration"}
"""Codes of reasons and warnings with which the next board would not be filmed completely, or not kept on disk."""
_HOLDING = NOT_READY - PASSING - {CODE, "ring-full"} | {"thread-lost", "boards-wait", "board-between-machines"}
"""Codes of warnings and faults that hold the next board back; those left out are found by themselves."""
VALID_S = 1.0
"""Time for which a permit is valid after it was given or renewed, s. At the latest then, the output falls."""
RENEW_S = 0.25
"""Shortest time between two renewals, s."""
_LARGEST = 0xFFFF
HEALTH_OLD_S = 2.0
"""Age of the last heartbeat of the acquisition process after which its devices no longer count as ready, s."""
_PTP = "Check that a PTP master is in its network, and that the switches pass PTP on; or set ptp = false for it."
_DEFAULT_ACTION = "Check its cable and power; the station reopens it automatically."


@dataclass(frozen=True)
class LineFacts:
    """What decides whether the next board may come."""

    state: StationState
    expects_board: bool
    """Whether memory is granted to the next board, and the line is not being disarmed."""
    health: Health | None
    without_cameras: bool
    """Whether the order accepts boards that are filmed without lost cameras."""
    reasons: tuple[Reason, ...]
    """Reasons for the station's state, warnings, and faults of threads."""
    now_s: float
    without_order: bool = False
    """Whether the line was armed for waiting orders, and none waits."""
    storage: Reason | None = None
    """The trouble because of which results are not kept on disk at present, also one that does not pass by itself."""


_BY_STATE = {
    StationState.STARTING: Reason(code="line-not-armed", message="The station is starting.", action="Wait."),
    StationState.IDLE: Reason(code="line-not-armed", message="The line is not armed.", action="Arm it."),
    StationState.ARMING: Reason(code="line-not-armed", message="The line is being armed.", action="Wait a moment."),
    StationState.FAULTED: Reason(code="line-not-armed", message="The acquisition process is lost.", action="Wait."),
    StationState.STOPPING: Reason(code="line-not-armed", message="The station is stopping.", action="Start it."),
    StationState.FILMING: Reason(code="line-filming", message="A board is being filmed.", action="Wait until it left."),
    StationState.BLOCKED: Reason(code="ring-full", message="No memory is free.", action="Wait, or release a run."),
}
_DISARMING = Reason(code="line-not-armed", message="The line is being disarmed.", action="Arm again.")
_NO_ORDER = Reason(
    code="no-order", message="No order waits for the next board.", action="Post its order, or arm for a board type."
)
_UNREPORTED = Reason(
    code="line-not-armed", message="Cameras and controller have not reported yet.", action="Wait a moment."
)
_SILENT = Reason(
    code="devices-silent",
    message="Cameras and controller have not reported for some seconds.",
    action="Wait: the station restarts the process.",
)
_NO_CONTROLLER = Reason(
    code="controller-not-ready",
    message="The controller does not reply, or has switched its outputs off.",
    action="Check its power and its cable.",
)
_PASSING = Reason(code="line-filming", message="A board is in the barrier.", action="Wait until it left.")
_STOPPED = Reason(
    code="belt-stopped",
    message="A board is in the barrier or under the cameras, and the belt does not move.",
    action="Start the belt. If it runs, check its encoder and the cable (vaoi doctor); disarm to end the run.",
)
_STANDING = Reason(
    code="board-in-barrier",
    message="A board has been in the light barrier since before the line was armed: it is not filmed.",
    action="Take it out and let it in again. If there is none, clean and align the barrier (vaoi doctor).",
)
EXPECTED = frozenset({"line-not-armed", "line-filming", "belt-stopped", "no-order", "boards-wait"})
"""Codes with which a board must wait although nothing is wrong."""


def held_back(facts: LineFacts, cameras: Sequence[CameraConfig]) -> tuple[Reason, ...]:
    """Return why the next board must wait; empty exactly if it may come.

    The page, `/readyz`, `line_ready` of REST and the output "line ready" all follow this function.
    """
    lost = () if facts.without_cameras else reasons(facts.health, cameras)
    others = (reason for reason in facts.reasons if reason.code in _HOLDING)
    found = (_held_by_line(facts), *lost, facts.storage, *others)
    return tuple(reason for reason in found if reason is not None)


def _held_by_line(facts: LineFacts) -> Reason | None:
    health = facts.health
    stopped = health is not None and health.belt_stopped
    if facts.state is not StationState.ARMED:
        return _STOPPED if facts.state is StationState.FILMING and stopped else _BY_STATE[facts.state]
    if facts.without_order:
        return _NO_ORDER
    if health is None or not facts.expects_board:
        return _UNREPORTED if facts.expects_board else _DISARMING
    silent = facts.now_s - health.host_time_s > HEALTH_OLD_S
    if silent or not health.controller_ready:
        return _SILENT if silent else _NO_CONTROLLER
    if health.standing:
        return _STANDING
    # The station's state is FILMING only from the first pulse on, and no longer after a run was given up.
    return (_STOPPED if stopped else _PASSING) if health.passing else None


def disconnected(health: Health | None) -> tuple[int, ...]:
    """Return the indices of the cameras that are not connected; none before the first health report."""
    return tuple(k for k, camera in enumerate(health.cameras if health else ()) if not camera.connected)


def reasons(health: Health | None, cameras: Sequence[CameraConfig]) -> tuple[Reason, ...]:
    """Return one reason for every camera that is not connected; none before the first health report."""
    if health is None:
        return ()
    away = ((cameras[k].label, health.cameras[k]) for k in disconnected(health))
    return tuple(
        Reason(code=CODE, message=not_connected(label, camera.message), action=camera.action or _DEFAULT_ACTION)
        for label, camera in away
    )


def require(health: Health | None, cameras: Sequence[CameraConfig]) -> None:
    """Raise DeviceError if a camera is not connected. The message names all such cameras."""
    if why := reasons(health, cameras):
        raise DeviceError(
            f"The array is not complete. {' '.join(reason.message for reason in why)}",
            action=f"{why[0].action} To film boards without it, arm with allow_lost_cameras.",
            code=CODE,
        )


def changes(before: Health | None, now: Health, cameras: Sequence[CameraConfig]) -> tuple[str, ...]:
    """Return one sentence per camera that was lost or connected again between two health reports."""
    # Before the first report all cameras count as connected, so that the first report names all that are not.
    were, are = set(disconnected(before)), set(disconnected(now))
    gone = (f"{sentence(cameras[k].label)} is lost: boards would be filmed without it." for k in sorted(are - were))
    back = (f"{sentence(cameras[k].label)} is ready again." for k in sorted(were - are))
    return (*gone, *back)


def ptp_warnings(health: Health | None, cameras: Sequence[CameraConfig]) -> tuple[Reason, ...]:
    """Return a warning for every camera with PTP that follows no master, or whose clock differs from the others'."""
    found = []
    for camera, seen in zip(cameras, health.cameras if health else (), strict=False):
        who, goes_on = sentence(camera.label).rstrip("."), "Boards are filmed: the station compares its clock itself."
        if seen.ptp is not None and not seen.ptp.synchronised:
            message = f"{who}: its clock follows no PTP master (state {seen.ptp.state or 'not stated'}). {goes_on}"
            found.append(Reason(code="ptp-not-synchronised", message=message, action=_PTP))
        elif seen.ptp is not None and seen.ptp.apart_s:
            off_ms = seen.ptp.apart_s * 1e3
            message = f"{who}: says {seen.ptp.state}, but differs by {off_ms:+.3f} ms from others with PTP. {goes_on}"
            found.append(Reason(code="ptp-clocks-apart", message=message, action=_PTP))
    return tuple(found)


def not_connected(label: str, why: str) -> str:
    """Return the message that a camera is not connected; `why` may begin with the camera's name, as of a driver."""
    return f"{sentence(label)} is not connected. {sentence(why.removeprefix(f'{label}: '))}".strip()


class LinePermit:
    """Permits for the output "line ready": one number for each board, renewed while the next board may come.

    It also publishes why boards are held back. Used by the coordinator's thread only.
    """

    def __init__(self, send: Callable[[PermitBoard], None] | None, publish: Callable[..., Any]) -> None:
        """Begin without a permit; `send` is None if the output is not used, `publish` is like `EventLog.add`."""
        self._send, self._publish = send, publish
        self._number = 0
        self._ready = False
        self._reports = 0
        self._renewed_s = float("-inf")
        self._troubles: tuple[str, ...] = ()

    def update(self, held: Sequence[Reason], reports: int, now_s: float) -> None:
        """Give, renew or withdraw the permit; `held` is why the next board must wait, empty if it may come.

        `reports` counts boards without a run so far: if it has changed, a board may have used the permit.
        """
        ready = not held
        fresh = ready and (not self._ready or reports != self._reports)
        if fresh:
            # Another number for each board: the firmware ignores a permit that a board has used up.
            self._number = self._number % _LARGEST + 1
        if self._send is not None:
            if ready and (fresh or now_s - self._renewed_s >= RENEW_S):
                self._renewed_s = now_s
                self._send(PermitBoard(Permit(self._number, now_s + VALID_S)))
            elif self._ready and not ready:
                self._send(PermitBoard(None))
        self._ready, self._reports = ready, reports

    def publish(self, troubles: Sequence[Reason]) -> None:
        """Publish a change of what holds boards back on an armed line; `troubles` is empty if nothing is wrong."""
        codes = tuple(reason.code for reason in troubles)
        if codes == self._troubles:
            return
        self._troubles = codes
        if troubles:
            first = troubles[0]
            message = f"Boards are held back: {first.message}"
            self._publish("line", message, code="line-held", action=first.action)
        else:
            self._publish("line", "Boards are no longer held back.", code="line-free")
