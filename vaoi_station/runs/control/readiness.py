"""Readiness of the cameras: the reasons why cameras are not connected, and the refusal to arm the line without them.

A camera that is not connected is absent, in use by another program, or refuses its settings. Without its frames, no
board is seen in the camera's view. The operator must know this before the batch starts.
"""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.acquisition.process.messages import Health
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.runs.control.reasons import sentence
from vaoi_station.runs.states.schemas import Reason

CODE = "camera-lost"
_DEFAULT_ACTION = "Check its cable and power; the station reopens it automatically."


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


def not_connected(label: str, why: str) -> str:
    """Return the message that a camera is not connected, with the cause `why`.

    A driver's message may begin with the camera's name. It is removed there, so that the name appears only once.
    """
    return f"{sentence(label)} is not connected. {sentence(why.removeprefix(f'{label}: '))}".strip()
