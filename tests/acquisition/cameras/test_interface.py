"""Tests of the camera interface: every backend without hardware has its methods with the same parameters."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.cameras.interface import CameraHealth, is_silent


@pytest.mark.parametrize(
    ("health", "silent"),
    [
        (CameraHealth(True, counters=(("n_received_packets", 0),)), True),
        (CameraHealth(True, counters=(("n_received_packets", 1),)), False),
        (CameraHealth(False, counters=(("n_received_packets", 0),)), False),
        (CameraHealth(True), False),
    ],
)
def test_only_a_connected_camera_that_counts_packets_can_be_silent(health: CameraHealth, silent: bool) -> None:
    assert is_silent(health) is silent
