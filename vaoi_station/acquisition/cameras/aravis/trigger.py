"""Recipes for the hardware trigger, one per make of camera: names of inputs differ, and the order of settings matters.

The steps are the same for all makes: turn the free frame rate off, turn every other trigger off, then set the mode, the
source and the edge of the frame trigger. Some makes need the mode off while the source changes. Some overlap exposure
and read-out only if a certain feature is set.
"""

from __future__ import annotations

from dataclasses import dataclass

FRAME_TRIGGERS = ("FrameStart", "FrameBurstStart", "AcquisitionStart")
"""GenICam names of the triggers that give one frame per pulse, in order of preference."""


@dataclass(frozen=True)
class Recipe:
    """The settings by which the hardware trigger of one make of camera is set."""

    line: str
    """GenICam name of the opto-isolated input."""
    off_while_changing: bool = False
    """Whether the camera refuses to change TriggerSource while TriggerMode is On."""
    extra: tuple[tuple[str, str], ...] = ()
    """(feature, value) of further settings, which are written if the camera has the feature."""
    sequencer_path: int = 0
    """The path of a sequencer that leads from set to set."""


# Input names: Line0 at FLIR, Line1 at Basler, Line2 at Lucid; the order of settings has side effects (Aravis #1045).
RECIPES = {
    "flir": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "point grey": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    "teledyne": Recipe("Line0", off_while_changing=True, extra=(("TriggerOverlap", "ReadOut"),)),
    # Path 0 of Basler's sequencers only leads back to set 0 (ace U, "Sequencer").
    "basler": Recipe("Line1", sequencer_path=1),
    "lucid": Recipe("Line2", extra=(("TriggerOverlap", "PreviousFrame"),)),
    "aravis": Recipe("Line0"),
}
"""For each make of camera, given by the beginning of its vendor's name in lower case: its recipe."""
GENERIC = Recipe("Line0", off_while_changing=True)
"""The recipe of unknown makes. It turns the mode off before the source changes, which cameras of all makes accept."""


def recipe_for(vendor: str) -> Recipe:
    """Return the recipe for a vendor's name. An unknown vendor gets the generic recipe."""
    name = vendor.casefold()
    return next((recipe for start, recipe in RECIPES.items() if name.startswith(start)), GENERIC)
