"""The description of an image has one name for every field of the REST interface."""

from __future__ import annotations

from typing import Any

from vaoi_station.api.rest_models import ViewEntry
from vaoi_station.library.component_images import FIELDS
from vaoi_station.rendering import compute_views
from vaoi_station.rendering.description import describe
from vaoi_station.rendering.selection import ChosenView, FrameFacts


def test_names_are_those_of_the_rest_interface_and_of_the_library(make: Any) -> None:
    s = make()
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras)[0]
    known = describe(ChosenView(view, FrameFacts()), None)
    assert set(known) == set(ViewEntry.model_fields) - {"k", "url"}
    assert set(FIELDS) <= set(known)
