"""A request for temporary images: how they are framed, which are wanted, and in which order."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal, TypedDict, get_args

import numpy as np

from vaoi_station.errors import InputError

Plane = Literal["board", "top"]
"""Plane in which a temporary image is right: the board's surface, or the top of the component's body."""
Alignment = Literal["cad", "part"]
"""What is upright in a picture: CAD, or the component as the CAD library draws it, at rotation 0."""
Side = Literal["left", "right", "front", "back"]
"""Side of the picture from which a component is seen; front is the picture's lower edge, back its upper edge."""
Order = Literal["best", "sharpest"]

AZIMUTHS: dict[str, float] = {"right": 0.0, "back": 90.0, "left": 180.0, "front": 270.0}
"""Azimuth in the picture of each side, degrees."""
WITHIN_DEG = 45.0
"""Largest difference from `seen_from` if none is stated."""
MOST_IMAGES = 100_000
MOST_MARGIN_MM = 100.0
"""Largest margin around a component that a caller may request; the limit of pixels is usually reached before."""
_LONGEST_US = 3.6e9
_LIMITS = {
    "px_per_mm": (0.1, 1000.0),
    "margin_mm": (0.0, MOST_MARGIN_MM),
    "min_coverage": (0.0, 1.0),
    "min_exposure_us": (0.0, _LONGEST_US),
    "max_exposure_us": (0.0, _LONGEST_US),
    "max_angle_deg": (0.0, 90.0),
    "min_angle_deg": (0.0, 90.0),
    "min_sharpness_per_mm": (0.0, 1e6),
    "max_saturated": (0.0, 1.0),
    "within_deg": (0.0, 180.0),
}
"""Least and largest value of the options that are numbers."""
_WORDS = {"align": get_args(Alignment), "plane": get_args(Plane), "order": get_args(Order)}


@dataclass(frozen=True)
class Framing:
    """How temporary images are framed."""

    px_per_mm: float | None = None
    """Resolution; None for the mean resolution of the cameras."""
    margin_mm: float = 0.0
    """Strip of surroundings on all sides of the component."""
    align: Alignment = "cad"
    plane: Plane = "board"
    """Plane in which the picture is right. Components without a known height are shown in the board's plane."""

    def check(self) -> Framing:
        """Return the framing. Raise InputError if a value is not of its type, or outside its limits."""
        _check(self)
        return self


@dataclass(frozen=True)
class Bounds:
    """Limits of the images that are wanted."""

    min_coverage: float = 0.5
    min_exposure_us: float | None = None
    max_exposure_us: float | None = None
    min_angle_deg: float = 0.0
    max_angle_deg: float = 90.0
    """Limits of the angle between the line of sight and the vertical."""
    min_sharpness_per_mm: float | None = None
    max_saturated: float | None = None

    def check(self) -> None:
        """Raise InputError if a value is not of its type, outside its limits, or contradicts another."""
        _check(self)
        for name in ("angle_deg", "exposure_us"):
            least, most = getattr(self, f"min_{name}"), getattr(self, f"max_{name}")
            if least is not None and most is not None and least > most:
                raise InputError.field("component images", f"min_{name}", least, f"at most max_{name}, {most:g}")


@dataclass(frozen=True)
class Choice:
    """Which images are wanted, and in which order."""

    light: str | None = None
    """Only images that were taken under this light."""
    minus: str | None = None
    """Subtract from each image the one under this light that sees the component most nearly from the same side."""
    seen_from: str | float | None = None
    """Only images that see the component from this side of the picture (`Side`), or from this azimuth in CAD, deg."""
    within_deg: float | None = None
    """Largest difference between the azimuth of an image and `seen_from`; None: `WITHIN_DEG`."""
    order: Order = "best"
    limit: int | None = None
    """Largest number of images."""
    measure: bool = False
    """Measure sharpness and saturation of every image, also if the selection does not need them."""

    def check(self) -> None:
        """Raise InputError if a value is not of its type, outside its limits, or needs another one."""
        if isinstance(self.seen_from, str):
            _check_word("seen_from", self.seen_from, get_args(Side))
        elif self.seen_from is not None and not (_is_number(self.seen_from) and 0 <= self.seen_from <= 360):
            limit = "'left', 'right', 'front', 'back' or an azimuth in CAD from 0 to 360"
            raise InputError.field("component images", "seen_from", self.seen_from, limit)
        _check(self)
        if self.within_deg is not None and self.seen_from is None:
            raise InputError(
                f"component images: within_deg is {self.within_deg:g}, but no seen_from is given that it belongs to.",
                action="Add seen_from.",
            )
        if self.limit is not None and not (type(self.limit) is int and 1 <= self.limit <= MOST_IMAGES):
            raise InputError.field("component images", "limit", self.limit, f"a whole number from 1 to {MOST_IMAGES}")
        if self.minus is not None and self.light is None:
            raise InputError(
                f"component images: minus is {self.minus!r}, but no light is given from which it is subtracted.",
                action="Add light.",
            )
        if self.minus is not None and self.minus == self.light:
            raise InputError.field("component images", "minus", self.minus, "another light than light")


class ImageOptions(TypedDict, total=False):
    """The options of a request by name, as the library and the command line take them."""

    px_per_mm: float | None
    margin_mm: float
    align: Alignment
    plane: Plane
    min_coverage: float
    min_exposure_us: float | None
    max_exposure_us: float | None
    min_angle_deg: float
    max_angle_deg: float
    min_sharpness_per_mm: float | None
    max_saturated: float | None
    light: str | None
    minus: str | None
    seen_from: str | float | None
    within_deg: float | None
    order: Order
    limit: int | None
    measure: bool


@dataclass(frozen=True)
class ImageRequest:
    """A request for the temporary images of one component."""

    framing: Framing = field(default_factory=Framing)
    bounds: Bounds = field(default_factory=Bounds)
    choice: Choice = field(default_factory=Choice)

    @staticmethod
    def of(options: ImageOptions) -> ImageRequest:
        """Make a request from options by name. Raise InputError if one is outside its limits, TypeError if unknown."""
        given: dict[str, Any] = dict(options)
        framing, bounds, choice = (
            {f.name: given.pop(f.name) for f in fields(kind) if f.name in given} for kind in (Framing, Bounds, Choice)
        )
        if given:
            raise TypeError(f"component images have no option {sorted(given)[0]!r}")
        return ImageRequest(Framing(**framing), Bounds(**bounds), Choice(**choice)).check()

    def check(self) -> ImageRequest:
        """Return the request. Raise InputError if a value is not of its type or outside its limits."""
        self.framing.check()
        self.bounds.check()
        self.choice.check()
        return self

    @property
    def needs_pixels(self) -> bool:
        """Whether frames must be measured to choose and order the images."""
        bounded = self.bounds.min_sharpness_per_mm is not None or self.bounds.max_saturated is not None
        return bounded or self.choice.order == "sharpest"

    def options(self) -> dict[str, Any]:
        """Return the options that differ from their defaults, by name."""
        own, default = ({**asdict(r.framing), **asdict(r.bounds), **asdict(r.choice)} for r in (self, ImageRequest()))
        return {name: value for name, value in own.items() if value != default[name]}

    def unmeasured(self) -> ImageRequest:
        """Return the same request without the wish to measure every image."""
        return replace(self, choice=replace(self.choice, measure=False))


def direction(text: str | None) -> str | float | None:
    """Return a side as a word and an azimuth as a number; `Choice.check` refuses everything else."""
    if text is None or text in get_args(Side):
        return text
    try:
        return float(text)
    except ValueError:
        return text


def check_number(name: str, value: object, *, optional: bool = False) -> None:
    """Raise InputError unless an option of component images is a number within its limits, or None if optional."""
    least, most = _LIMITS[name]
    if optional and value is None:
        return
    if not _is_number(value) or not least <= value <= most:  # type: ignore[operator]  # it is a number here
        limit = f"{'None or ' if optional else ''}a number from {least:g} to {most:g}"
        raise InputError.field("component images", name, value, limit)


def _check(options: Framing | Bounds | Choice) -> None:
    """Raise InputError for the first option that is not a number within its limits, or not one of its words."""
    for option in fields(options):
        value = getattr(options, option.name)
        if option.name in _LIMITS:
            check_number(option.name, value, optional=option.default is None)
        elif option.name in _WORDS:
            _check_word(option.name, value, _WORDS[option.name])


def _check_word(name: str, value: object, known: tuple[str, ...]) -> None:
    if value not in known:
        raise InputError.field("component images", name, value, " or ".join(map(repr, known)))


def _is_number(value: Any) -> bool:
    """Return whether a value is a number other than NaN; booleans are none."""
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return real and value == value  # noqa: PLR0124  NaN is the one number that differs from itself
