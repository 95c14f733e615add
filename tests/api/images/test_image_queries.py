"""Query parameters of images: all options of the library, with the same defaults."""

from __future__ import annotations

import asyncio
import inspect
from typing import Any

import pytest

from vaoi_station.api.images import image_queries
from vaoi_station.errors import InputError
from vaoi_station.rendering.framing import Framing
from vaoi_station.rendering.request import Bounds, Choice, ImageOptions, ImageRequest


def parameters() -> dict[str, Any]:
    makers = (image_queries._framing, image_queries._bounds, image_queries._choice)
    return {name: p.default for maker in makers for name, p in inspect.signature(maker).parameters.items()}


def test_every_option_is_a_parameter_with_its_default() -> None:
    assert set(parameters()) == set(ImageOptions.__annotations__)
    defaults = ImageRequest()
    for name, value in parameters().items():
        owner = next(part for part in (defaults.framing, defaults.bounds, defaults.choice) if hasattr(part, name))
        assert getattr(owner, name) == value, name


def test_parameters_make_the_request() -> None:
    framing = asyncio.run(image_queries._framing(20.0, 0.5, "part", "top"))
    bounds = asyncio.run(image_queries._bounds(0.9, 1.0, 2.0, 3.0, 4.0, 5.0, 0.1))
    choice = asyncio.run(image_queries._choice("left", "right", "120", 30.0, "sharpest", 2, True))
    assert framing == Framing(20.0, 0.5, "part", "top")
    assert bounds == Bounds(0.9, 1.0, 2.0, 3.0, 4.0, 5.0, 0.1)
    assert choice == Choice("left", "right", 120.0, 30.0, "sharpest", 2, True)
    assert asyncio.run(image_queries._wanted(framing, bounds, choice)) == ImageRequest(framing, bounds, choice)


def test_contradictions_are_refused() -> None:
    with pytest.raises(InputError, match="min_angle_deg"):
        asyncio.run(image_queries._wanted(Framing(), Bounds(min_angle_deg=20, max_angle_deg=10), Choice()))
