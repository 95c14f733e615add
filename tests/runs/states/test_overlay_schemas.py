"""What is drawn over a board becomes JSON as it is, and refuses unknown keys."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.states.overlay_schemas import OverlayFiducial, OverlayLinks, RunOverlay


def test_an_overlay_survives_json() -> None:
    links = OverlayLinks(a=(0, 0), b=(0, 1), found=3, used=2, at=(1.0, 2.0), residual=(0.1, 0.0), residual_px=0.8)
    mark = OverlayFiducial(name="F1", at=(1, 1), diameter=1, sightings=0)
    overlay = RunOverlay(unit="inch", px_per_mm=18.0, frames=(), links=(links,), fiducials=(mark,))
    assert RunOverlay.model_validate_json(overlay.model_dump_json()) == overlay


def test_unknown_keys_are_refused() -> None:
    with pytest.raises(ValidationError, match="colour"):
        OverlayFiducial(name="F1", at=(1, 1), diameter=1, sightings=0, colour="red")  # type: ignore[call-arg]
