"""Mistakes and faults of the hostile suite: what the station is given wrongly, and what spoils its pictures.

Each mistake has a size, and limits within which the rule of `rule.py` expects a right answer. The size of a scenario's
setting (belt, light, board) changes the scenario; the others change calibration, board type or frames.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.simulation import Scenario

Random = np.random.Generator
Update = dict[str, dict[str, Any]]
"""Changed keys of a scenario, by section."""


@dataclass(frozen=True)
class Mistake:
    """One mistake of a drawing: its name, its size in the unit of its limit, and the camera or row it concerns."""

    name: str
    size: float
    at: int = 0
    angle_rad: float = 0.0

    @property
    def within(self) -> bool:
        """Whether a right answer is expected in spite of this mistake."""
        return self.size <= EVERY_KIND[self.name].limit

    def __str__(self) -> str:
        return f"{self.name} {self.size:.3g}"


@dataclass(frozen=True)
class Kind:
    """One kind of mistake: the range of its size (drawn with even logarithm), and the largest size within limits."""

    low: float
    high: float
    limit: float
    unit: str
    whole: bool = False
    """Whether sizes are whole numbers."""


_NEVER = -1.0
KINDS: Mapping[str, Kind] = {
    # belt and board
    "speed-error": Kind(0.01, 0.45, 0.08, "share of the nominal speed"),
    "slip": Kind(0.01, 0.2, 0.03, "rms share of the speed"),
    "yaw": Kind(0.3, 12, 3, "degrees"),
    "yaw-rate": Kind(0.05, 8, 0.5, "degrees/s"),
    "stuck": Kind(1, 4, _NEVER, "row at which the board stops", whole=True),
    "turned": Kind(90, 270, _NEVER, "degrees"),
    "lift": Kind(0.1, 5, 0.8, "mm"),
    "bow": Kind(0.05, 2.5, 0.4, "mm"),
    "tilt": Kind(0.02, 1.5, 0.15, "mm at the edge"),
    "absent-parts": Kind(1, 6, 6, "parts", whole=True),
    # light and sensor
    "dark": Kind(1, 12, 2.5, "times less light"),
    "bright": Kind(1, 4, 1.3, "times more light"),
    "read-noise": Kind(2, 20, 4, "grey levels"),
    "shot-noise": Kind(0.05, 0.3, 0.08, "share of the level"),
    "blur": Kind(0.8, 5, 1.3, "px"),
    "motion-blur": Kind(0.3, 10, 1, "px"),
    "exposures": Kind(1.1, 5, 2, "ratio of neighbouring cameras"),
    "flicker": Kind(0.02, 0.4, 0.05, "rms share of the brightness"),
    "glare": Kind(10, 200, 25, "grey levels of a spot that stays in the picture"),
    "dirt": Kind(0.05, 0.9, 0.15, "share of the light that a spot in the picture takes away"),
    # calibration
    "pushed": Kind(0.03, 1.2, 0.15, "px"),
    "knocked": Kind(0.003, 0.1, 0.015, "degrees about the optical axis"),
    "tilted": Kind(0.001, 0.03, 0.0018, "degrees about the image's x axis; 0.0018 are 0.15 px"),
    "four-marks": Kind(0.05, 2, _NEVER, "px of distortion, calibrated with four marks a camera"),
    "many-marks": Kind(0.05, 2, 1, "px of distortion, calibrated with 25 marks a camera"),
    "lens-ignored": Kind(0.1, 2, _NEVER, "px of distortion that the calibration leaves out"),
    "cables-swapped": Kind(1, 1, _NEVER, "pair of cameras"),
    # board type
    "other-type": Kind(1, 1, _NEVER, "board type of the same size with other parts"),
    "other-size": Kind(1.03, 1.3, _NEVER, "times longer board type"),
    "fiducial-moved": Kind(0.05, 1.5, _NEVER, "mm in the CAD data; less is the tolerance of artwork"),
    "fiducial-size": Kind(1.02, 2.2, 1.05, "times wider in the CAD data"),
    "scaled": Kind(0.0001, 0.02, 0.0002, "share by which the CAD data are too large"),
    "mirrored": Kind(1, 1, _NEVER, "wrong y axis"),
    # frames
    "missing-camera": Kind(1, 1, _NEVER, "camera without frames"),
    "missing-rows": Kind(1, 3, 1, "rows one after the other", whole=True),
    "missing-frames": Kind(1, 6, 2, "frames", whole=True),
    "frozen": Kind(1, 1, _NEVER, "camera that repeats its first frame"),
    "repeated": Kind(1, 1, _NEVER, "frame that is that of the row before"),
    "late-camera": Kind(1, 1, _NEVER, "camera whose frames are one row late"),
    "black-band": Kind(0.1, 0.7, _NEVER, "share of a camera's frames that stays black"),
    # knowledge of earlier boards
    "reference": Kind(1, 1, 1, "taught board of the same type"),
}
"""All kinds of mistakes. A limit below every size means that no right answer is expected."""


BESIDE: Mapping[str, Kind] = {
    "bed-texture": Kind(3, 40, 15, "grey levels (σ) of texture that stands still, 0 to 3 mm below the board"),
    "belt-texture": Kind(3, 40, 15, "grey levels (σ) of texture that moves with the board, 0 to 3 mm below it"),
    "carrier": Kind(4, 12, 12, "mm of rim, brighter than the board, with three marks like fiducials"),
}
"""Kinds of what lies beside the board. They are drawn apart from the others (`drawing.py`)."""
NEAR_COPY = "near-copy"
MOMENTS: Mapping[str, Kind] = {
    NEAR_COPY: Kind(1, 5, _NEVER, "grey levels (σ) of fresh noise in a frame that shows the row before"),
}
"""Kinds of frames of another moment that equal no other frame. They are drawn apart from the others, too."""
EVERY_KIND: Mapping[str, Kind] = {**KINDS, **BESIDE, **MOMENTS}
_LOWEST_MM = 3.0


def draw_beside(g: Random) -> tuple[Mistake, ...]:
    """Draw what lies beside the board: nothing special in every fifth drawing, else one kind."""
    if g.uniform() < 0.2:
        return ()
    return (_draw_one(str(g.choice(sorted(BESIDE))), g, 1, BESIDE),)


def draw_moment(g: Random, cameras: int) -> tuple[Mistake, ...]:
    """Draw whether a frame shows another moment: in every fifth drawing."""
    return (_draw_one(NEAR_COPY, g, cameras, MOMENTS),) if g.uniform() < 0.2 else ()


def draw_mistakes(g: Random, cameras: int) -> tuple[Mistake, ...]:
    """Draw no to three mistakes of different kinds."""
    count = int(g.choice(4, p=[0.3, 0.4, 0.22, 0.08]))
    names = g.choice(sorted(KINDS), size=count, replace=False)
    return tuple(_draw_one(str(name), g, cameras) for name in names)


def _draw_one(name: str, g: Random, cameras: int, kinds: Mapping[str, Kind] = KINDS) -> Mistake:
    kind = kinds[name]
    size = float(np.exp(g.uniform(np.log(kind.low), np.log(kind.high))))
    size = float(np.floor(size)) if kind.whole else size
    return Mistake(name, size, int(g.integers(cameras)), float(g.uniform(-np.pi, np.pi)))


def scenario_changes(m: Mistake, s: Scenario) -> Update:
    """Return the changes of the scenario that a mistake makes; nothing for a mistake that changes other data."""
    change = _SCENARIO.get(m.name)
    return change(m, s) if change else {}


def _signed(m: Mistake) -> float:
    return m.size if m.angle_rad > 0 else -m.size


def _turned(m: Mistake, s: Scenario) -> Update:
    # A lying rectangle may leave the view; half of the turned boards therefore lie upside down.
    turned = 180 if m.angle_rad > 0 else 90 if m.size < 160 else 270
    return {"faults": {"turned": ({"turned_deg": turned},)}}


def _exposures(m: Mistake, s: Scenario) -> Update:
    return {"array": {"exposures_us": tuple(250.0 / m.size if i % 2 else 250.0 for i in range(s.array.cameras))}}


def _gain(factor: float, s: Scenario) -> Update:
    return {"array": {"gain": s.array.gain * factor}}


def _motion_blur(m: Mistake, s: Scenario) -> Update:
    # The amount of light stays, as with an aperture that is closed accordingly.
    us = m.size / s.array.px_per_mm / s.belt.speed_mm_s * 1e6
    return {"array": {"exposures_us": (us,), "reference_exposure_us": us}}


def _texture(m: Mistake, follows: float) -> Update:
    below = _LOWEST_MM * abs(m.angle_rad) / np.pi
    return {"texture": {"sigma_grey": m.size, "follows": follows, "below_mm": below, "seed": int(1e6 * m.size)}}


def _carrier(m: Mistake, s: Scenario) -> Update:
    w, h, out = s.board.width_mm, s.board.length_mm, m.size / 2
    along = 0.5 + 0.4 * np.cos(m.angle_rad)
    marks = [(-out, h * along), (w + out, h * (1 - along)), (w * along, -out)]
    return {
        "carrier": {
            "rim_mm": m.size,
            "grey": 150 + 40 * np.sin(3 * m.angle_rad),
            "below_mm": max(0.0, np.sin(5 * m.angle_rad)),
            "marks": tuple({"x_mm": float(x), "y_mm": float(y)} for x, y in marks),
        }
    }


_SCENARIO: Mapping[str, Callable[[Mistake, Scenario], Update]] = {
    "speed-error": lambda m, s: {"belt": {"speed_error": _signed(m)}},
    "slip": lambda m, s: {"belt": {"speed_wander": m.size}},
    "yaw": lambda m, s: {"belt": {"yaw_deg": _signed(m), "yaw_sigma_deg": 0.0}},
    "yaw-rate": lambda m, s: {"belt": {"yaw_rate_deg_s": _signed(m)}},
    "stuck": lambda m, s: {"faults": {"stuck": ({"row": int(m.size)},)}},
    "turned": _turned,
    "lift": lambda m, s: {"board": {"lift_mm": _signed(m)}},
    "bow": lambda m, s: {"board": {"bow_mm": _signed(m)}},
    "tilt": lambda m, s: {"board": {"tilt_mm": (m.size * np.cos(m.angle_rad), m.size * np.sin(m.angle_rad))}},
    "dark": lambda m, s: _gain(1 / m.size, s),
    "bright": lambda m, s: _gain(m.size, s),
    "read-noise": lambda m, s: {"array": {"read_noise": m.size}},
    "shot-noise": lambda m, s: {"array": {"shot_noise": m.size}},
    "blur": lambda m, s: {"array": {"psf_px": m.size}},
    "motion-blur": _motion_blur,
    "exposures": _exposures,
    "flicker": lambda m, s: {"array": {"flicker": m.size}},
    "four-marks": lambda m, s: {"array": {"distortion_px": m.size}, "calibration_board": {"marks_per_axis": 2}},
    "many-marks": lambda m, s: {"array": {"distortion_px": m.size}, "calibration_board": {"marks_per_axis": 5}},
    "lens-ignored": lambda m, s: {"array": {"distortion_px": m.size}},
    "bed-texture": lambda m, s: _texture(m, 0.0),
    "belt-texture": lambda m, s: _texture(m, 1.0),
    "carrier": _carrier,
}


def spoil(pixels: NDArray[Any], mistake: Mistake) -> NDArray[Any]:
    """Return the frame (h, w) of a camera as a mistake spoils it; a copy if it does."""
    h, w = pixels.shape
    if mistake.name == "black-band":
        spoilt = pixels.copy()
        spoilt[:, : int(w * mistake.size)] = 0
        return spoilt
    if mistake.name not in {"glare", "dirt"}:
        return pixels
    # The spot stays at the same place of the picture, anywhere in it, and is an eighth of it wide.
    x, y = (0.5 + 0.4 * np.cos(mistake.angle_rad)) * w, (0.5 + 0.4 * np.sin(3 * mistake.angle_rad)) * h
    distance2 = (np.arange(w) - x) ** 2 + (np.arange(h)[:, None] - y) ** 2
    spot = mistake.size * np.exp(-distance2 / (2 * (w / 16) ** 2))
    changed = pixels + spot if mistake.name == "glare" else pixels * (1 - spot)
    return np.asarray(np.clip(np.rint(changed), 0, np.iinfo(pixels.dtype).max), pixels.dtype)
