"""The example configurations fit the shipped scenario, and the documentation names every key."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.acquisition.process.backends import check_backends
from vaoi_station.acquisition.ring import RingLayout
from vaoi_station.config import read_config
from vaoi_station.optics import make_plan
from vaoi_station.optics.report import PAPER
from vaoi_station.simulation import scenario_path

ROOT = Path(__file__).resolve().parents[2]


def test_example_fits_the_shipped_scenario() -> None:
    config = read_config(ROOT / "deploy" / "station.toml")
    assert config.simulation is not None
    shipped = config.simulation.model_copy(update={"scenario": scenario_path("demo")})
    check_backends(config.model_copy(update={"simulation": shipped}))


def test_example_of_the_paper_agrees_with_the_plan() -> None:
    """Pitch, view, rate and memory of deploy/station-paper.toml are those of `vaoi plan --example paper`."""
    config = read_config(ROOT / "deploy" / "station-paper.toml")
    plan = make_plan(PAPER)
    assert len(config.cameras) == plan.array.cameras
    centers = [camera.nominal_center_mm or (0.0, 0.0) for camera in config.cameras]
    assert [x for x, _ in centers] == pytest.approx([k * plan.array.camera_pitch_mm for k in range(12)], abs=0.05)
    assert {(c.width, c.height, c.nominal_px_per_mm) for c in config.cameras} == {
        (PAPER.sensor_px_h, PAPER.sensor_px_v, PAPER.resolution_px_per_mm)
    }
    lowest_hz = PAPER.speed_mm_s * PAPER.resolution_px_per_mm * PAPER.multiplicity_v / PAPER.sensor_px_v
    assert 1 / config.line.trigger_period_s == pytest.approx(lowest_hz, rel=1e-3)
    light = config.controller.lights["bars"]
    assert light.on_us == plan.motion.exposure_us
    assert all(camera.exposure_us > light.on_us for camera in config.cameras)
    half_view_mm = plan.array.field_height_mm / 2
    assert -half_view_mm < config.line.barrier_mm + config.line.start_delay_s * PAPER.speed_mm_s < 0
    assert config.line.barrier_mm + config.line.tail_s * PAPER.speed_mm_s > half_view_mm
    assert f"{RingLayout.of(config).file_bytes / 1e9:.1f} GB" in (ROOT / "deploy" / "station-paper.toml").read_text()
