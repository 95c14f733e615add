"""Temporary images: upright, CAD-aligned pictures of components, resampled from the frames (paper, section 3.4)."""

from vaoi_station.rendering.request import Framing, ImageOptions, ImageRequest
from vaoi_station.rendering.selection import (
    ChosenImages,
    ChosenView,
    FrameFacts,
    Measures,
    choose_all,
    measure,
    render_chosen,
)
from vaoi_station.rendering.temporary import render, render_all
from vaoi_station.rendering.views import View, ViewCalculator

__all__ = [
    "ChosenImages",
    "ChosenView",
    "FrameFacts",
    "Framing",
    "ImageOptions",
    "ImageRequest",
    "Measures",
    "View",
    "ViewCalculator",
    "choose_all",
    "measure",
    "render",
    "render_all",
    "render_chosen",
]
