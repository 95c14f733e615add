"""A request for temporary images: how they are framed, which are wanted, and in which order."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal, TypedDict, get_args

from vaoi_station.errors import InputError
from vaoi_station.rendering.framing import Alignment, Framing, check_number, check_word, is_number
from vaoi_station.rendering.view import Plane

Side = Literal["left", "right", "front", "back"]
"""Side of the picture from which a component is seen; front is the picture's lower edge, back its upper edge."""
Order = Literal["best", "sharpest"]

AZIMUTHS: dict[str, float] = {"right": 0.0, "back": 90.0, "left": 180.0, "front": 270.0}
"""Azimuth in the picture of each side, degrees."""
WITHIN_DEG = 45.0
"""Largest difference from `seen_from` if none is stated."""
MOST_IMAGES = 100_000
_LONGEST_US = 3.6e9


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
        check_number("min_coverage", self.min_coverage, 0.0, 1.0)
        check_number("min_exposure_us", self.min_exposure_us, 0.0, _LONGEST_US, optional=True)
        check_number("max_exposure_us", self.max_exposure_us, 0.0, _LONGEST_US, optional=True)
        check_number("max_angle_deg", self.max_angle_deg, 0.0, 90.0)
        check_number("min_angle_deg", self.min_angle_deg, 0.0, 90.0)
        check_number("min_sharpness_per_mm", self.min_sharpness_per_mm, 0.0, 1e6, optional=True)
        check_number("max_saturated", self.max_saturated, 0.0, 1.0, optional=True)
        _in_order("angle_deg", self.min_angle_deg, self.max_angle_deg)
        _in_order("exposure_us", self.min_exposure_us, self.max_exposure_us)


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
            check_word("seen_from", self.seen_from, get_args(Side))
        elif self.seen_from is not None and not (is_number(self.seen_from) and 0 <= self.seen_from <= 360):
            limit = "'left', 'right', 'front', 'back' or an azimuth in CAD from 0 to 360"
            raise InputError.field("component images", "seen_from", self.seen_from, limit)
        check_number("within_deg", self.within_deg, 0.0, 180.0, optional=True)
        if self.within_deg is not None and self.seen_from is None:
            raise InputError(
                f"component images: within_deg is {self.within_deg:g}, but no seen_from is given that it belongs to.",
                action="Add seen_from.",
            )
        check_word("order", self.order, get_args(Order))
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


def _in_order(name: str, least: float | None, most: float | None) -> None:
    if least is not None and most is not None and least > most:
        raise InputError.field("component images", f"min_{name}", least, f"at most max_{name}, {most:g}")
