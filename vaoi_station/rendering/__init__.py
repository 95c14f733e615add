"""Temporary images: upright, CAD-aligned pictures of components, resampled from the frames (paper, section 3.4)."""

from vaoi_station.rendering.chooser import ChosenImages, choose_all, choose_images, render_chosen
from vaoi_station.rendering.framing import Framing
from vaoi_station.rendering.measures import Measures, measure
from vaoi_station.rendering.request import ImageOptions, ImageRequest
from vaoi_station.rendering.selection import ChosenView, FrameFacts
from vaoi_station.rendering.temporary import render, render_all
from vaoi_station.rendering.view import View
from vaoi_station.rendering.views import ViewCalculator, compute_views

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
    "choose_images",
    "compute_views",
    "measure",
    "render",
    "render_all",
    "render_chosen",
]
