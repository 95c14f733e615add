"""Recipes for the hardware trigger, one per make: names of inputs differ, and the order of settings matters.

The steps are the same for all: the trigger sets the frame rate, every other trigger is off, then mode, source, edge.
Some makes need the mode off while the source changes, or overlap exposure and read-out only on request.
"""

from __future__ import annotations

from dataclasses import dataclass

FRAME_TRIGGERS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
"""Triggers that give one frame per pulse, in order of preference."""


@dataclass(frozen=True)
class Recipe:
    """The particulars of a make."""

    line: str
    """GenICam name of the opto-isolated input."""
    off_while_changing: bool = False
    """Whether TriggerSource is refused while TriggerMode is On."""
    extra: tuple[tuple[str, str], ...] = ()
    """Further features and values, written where the camera has them."""


# Input names: Line0 at FLIR, Line1 at Basler, Line2 at Lucid; the order of settings has side effects (Aravis #1045).
RECIPES = {
    "flir": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "point grey": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "teledyne": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "basler": Recipe("Line1"),
    "lucid": Recipe("Line2", extra=(("TriggerOverlap", "PreviousFrame"),)),
    "aravis": Recipe("Line0"),
}
"""Recipes by the beginning of the vendor's name."""
GENERIC = Recipe("Line0", off_while_changing=True)
"""The recipe of unknown makes: switching the mode off first is accepted by all."""


def recipe_for(vendor: str) -> Recipe:
    """Return the recipe of a make; the generic one if it is unknown."""
    name = vendor.casefold()
    return next((recipe for start, recipe in RECIPES.items() if name.startswith(start)), GENERIC)
