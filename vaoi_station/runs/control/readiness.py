"""Whether every camera is ready: what is said of those that are not, and the refusal to arm without them.

A camera that is not connected has no frames: it is absent, another program has it, or it does not take its settings. A
board that is filmed all the same has a gap as wide as the camera's view, which nobody should find out from its result.
"""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.acquisition.process.messages import Health
from vaoi_station.config import CameraConfig
from vaoi_station.errors import DeviceError
from vaoi_station.runs.control.reasons import sentence
from vaoi_station.runs.states.schemas import Reason

CODE = "camera-lost"
_REMEDY = "Check its cable and power; it is opened again by itself."


def lost(health: Health | None) -> tuple[int, ...]:
    """Cameras that are not ready; none while nothing is known of them."""
    return tuple(k for k, camera in enumerate(health.cameras if health else ()) if not camera.connected)


def reasons(health: Health | None, cameras: Sequence[CameraConfig]) -> tuple[Reason, ...]:
    """Of every camera that is not ready, why."""
    if health is None:
        return ()
    away = ((cameras[k].label, health.cameras[k]) for k in lost(health))
    return tuple(
        Reason(code=CODE, message=not_connected(called, camera.message), action=camera.action or _REMEDY)
        for called, camera in away
    )


def require(health: Health | None, cameras: Sequence[CameraConfig]) -> None:
    """DeviceError that names every camera that is not ready."""
    if why := reasons(health, cameras):
        raise DeviceError(
            f"The array is not complete. {' '.join(reason.message for reason in why)}",
            action=f"{why[0].action} To film boards without it all the same, arm with allow_lost_cameras.",
            code=CODE,
        )


def changes(before: Health | None, now: Health, cameras: Sequence[CameraConfig]) -> tuple[str, ...]:
    """Sentences for cameras that have been lost, and for those that are back."""
    were, are = set(lost(before)), set(lost(now))
    gone = (f"{sentence(cameras[k].label)} is lost: boards would be filmed without it." for k in sorted(are - were))
    back = (f"{sentence(cameras[k].label)} is ready again." for k in sorted(were - are))
    return (*gone, *back)


def not_connected(called: str, why: str) -> str:
    """The camera is named once, though its own words may begin with its name."""
    return f"{sentence(called)} is not connected. {sentence(why.removeprefix(f'{called}: '))}".strip()
