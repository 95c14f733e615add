"""The methods of stitching, and the evidence each may use (sections 3.3.1 to 3.3.3 of the paper).

Each method uses only the kinds of evidence that `METHODS` allows for it. The method `auto` uses all kinds.
"""

from __future__ import annotations

from dataclasses import dataclass

from vaoi_station.config import MethodName

__all__ = ["METHODS", "Method", "MethodName"]


@dataclass(frozen=True)
class Method:
    """The kinds of evidence that a stitching method may use."""

    links: bool
    """Whether to use texture that is linked from row to row and from camera to camera."""
    marks: bool
    """Whether to use the fiducials of the board."""
    fixture: bool
    """Whether to use the fixture marks."""
    reference: bool
    """Whether to use texture that is linked to a reference run of the same board type."""


METHODS: dict[str, Method] = {
    "auto": Method(links=True, marks=True, fixture=True, reference=True),
    "features": Method(links=True, marks=True, fixture=False, reference=False),
    "fiducials": Method(links=False, marks=True, fixture=True, reference=False),
    "reference": Method(links=False, marks=False, fixture=False, reference=True),
}
