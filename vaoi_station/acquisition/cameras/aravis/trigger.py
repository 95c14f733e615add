"""How cameras are told to wait for a wire: a recipe per make, because inputs are counted differently and order matters.

The steps are the same everywhere: the frame rate is left to the trigger, every other trigger is off, then mode, source,
edge. Some makes want the mode off while the source changes, or let exposure and read-out overlap only if asked.
"""

from __future__ import annotations

from dataclasses import dataclass

FRAME_TRIGGERS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
"""What one pulse should cause, the first that a camera has."""


@dataclass(frozen=True)
class Recipe:
    """What is particular about a make."""

    line: str
    """The opto-isolated input of its cable, by its GenICam name."""
    off_while_changing: bool = False
    """TriggerSource is refused while TriggerMode is On."""
    extra: tuple[tuple[str, str], ...] = ()
    """Features and their values, written where the camera has them."""


RECIPES = {
    "flir": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "point grey": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "teledyne": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "basler": Recipe("Line1"),
    "lucid": Recipe("Line2", extra=(("TriggerOverlap", "PreviousFrame"),)),
    "aravis": Recipe("Line0"),
}
"""By the beginning of the vendor's name."""
GENERIC = Recipe("Line0", off_while_changing=True)


def recipe_for(vendor: str) -> Recipe:
    """The recipe of a make; a careful one for the unknown."""
    name = vendor.casefold()
    return next((recipe for start, recipe in RECIPES.items() if name.startswith(start)), GENERIC)
