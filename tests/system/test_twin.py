"""A station on the digital twin: results agree with the truth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from vaoi_station.config import StationConfig
from vaoi_station.model import Status
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.control.order_requests import WantedOrder
from vaoi_station.simulation import Twin

TIMEOUT_S = 150.0


def test_component_positions_agree_with_the_truth_of_the_twin(
    twin_config: StationConfig, run_station: Callable[[StationConfig], StationCoordinator], twin: Twin
) -> None:
    coordinator = run_station(twin_config.model_copy(update={"workers": 1}))
    for board_id in ("b1", "b2"):
        coordinator.orders.add(WantedOrder("small", board_id))
    coordinator.arm(None)
    first = coordinator.next_run(None, TIMEOUT_S)
    assert first is not None, coordinator.snapshot()
    second = coordinator.next_run(first.id, TIMEOUT_S)
    assert second is not None
    assert (first.board_id, second.board_id) == ("b1", "b2"), "each board takes the order that waited for it"
    for number, run in enumerate((first, second)):
        assert run.verdict is Status.OK, run.reasons
        truth = twin.passage(number).truth()
        assert run.rows == twin.passage(number).rows
        found = coordinator.stitch(run.id).components
        assert found is not None
        errors = [
            np.hypot(x - tx, y - ty)
            for ref, views in truth["views"].items()
            for camera, row, tx, ty in views
            for c, r, x, y in found[ref]
            if (c, r) == (camera, row)
        ]
        assert len(errors) > 50
        assert np.sqrt(np.mean(np.square(errors))) < 0.5, "px"
        assert run.belt is not None
        assert abs(run.belt.ratio - 1) < 0.05
