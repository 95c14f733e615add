"""Temporary images: upright, CAD-aligned pictures of components, resampled from the frames (section 3.4)."""

from vaoi_station.rendering.temporary import render
from vaoi_station.rendering.views import Album, View, views_of

__all__ = ["Album", "View", "render", "views_of"]
