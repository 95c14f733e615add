"""Tiles follow the motion of the board, and every pair of frames is an edge."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.tile_graph import layout, tile_graph


def test_tiles_are_placed_as_cameras_and_belt_predict(stitched: StitchedRun) -> None:
    plan = layout(stitched)
    assert set(plan.corners) == set(stitched.opened.present)
    head, camera = stitched.head, stitched.opened.setup.cameras[0]
    wide = float(np.hypot(*(plan.corners[0, 0][1] - plan.corners[0, 0][0])))
    scale = wide / camera.width_px * camera.px_per_mm
    step_mm = (plan.middle((0, 1)) - plan.middle((0, 0))) / scale
    belt_mm = -np.array(head.conveyor_mm_s) * head.trigger_period_s
    assert step_mm == pytest.approx(belt_mm, abs=0.5)
    assert plan.middle((1, 0))[0] > plan.middle((0, 0))[0]
    everything = np.concatenate(list(plan.corners.values()))
    assert everything.min() >= 0
    assert everything[:, 0].max() <= plan.width
    assert everything[:, 1].max() <= plan.height


def test_every_pair_is_an_edge_with_its_links(stitched: StitchedRun) -> None:
    html = tile_graph(stitched).html()
    linked = [p for p in stitched.pairs if len(p.links.a_px)]
    assert html.count(" links, correlation ") == len(linked)
    assert html.count("stroke-dasharray") == len(stitched.pairs) - len(linked)
    unlinked = stitched.result.quality["unlinked"]
    assert len(unlinked) == len(stitched.pairs) - len(linked)
    for entry in unlinked:
        assert entry["reason"] in html
