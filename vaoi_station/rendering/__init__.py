"""Temporary images: upright, CAD-aligned pictures of components, resampled from the frames (paper, section 3.4)."""

from vaoi_station.rendering.framing import Framing
from vaoi_station.rendering.temporary import render
from vaoi_station.rendering.view import View
from vaoi_station.rendering.views import ViewCalculator, compute_views

__all__ = ["Framing", "View", "ViewCalculator", "compute_views", "render"]
