"""The images of a component of the held station, chosen from its frames as the real station does."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vaoi_station.errors import NotFoundError
from vaoi_station.model import Verdict
from vaoi_station.rendering import ChosenImages, FrameFacts, ImageRequest, ViewCalculator, choose_all, measure

if TYPE_CHECKING:
    from tests.api.held_station import HeldStation


def chosen_images(station: HeldStation, run: str, ref: str, wanted: ImageRequest) -> ChosenImages:
    """Choose images from the usable frames of a run; raise NotFoundError for an unknown component."""
    board_type, stitch = station.types["demo-board"], station.stitch(run)
    component = board_type.component(ref)
    if component is None:
        raise NotFoundError(f"There is no component {ref!r}.", code="unknown-component")
    records = station.run(run).frames
    whole = {(r.camera, r.row) for r in records if r.verdict == Verdict.OK}
    facts = {(r.camera, r.row): FrameFacts(r.exposure_us, r.gain, r.light, 0.1 * r.row) for r in records}
    return choose_all(
        ViewCalculator(board_type, stitch, station.cameras),
        [component],
        (board_type, stitch),
        (whole, facts),
        wanted,
        lambda view: measure(view, station.pixels[run, view.camera, view.row]),
    )[0]
