from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path

Make = Callable[..., Twin]


@pytest.fixture(scope="session")
def small() -> Twin:
    """The small scenario that comes with the software."""
    return Twin(read_scenario(scenario_path("small")))


@pytest.fixture(scope="session")
def make() -> Make:
    """A twin of one small camera without noise, blur, vignetting, flicker or parts; sections may be overridden."""

    def twin(**sections: dict[str, Any]) -> Twin:
        base: dict[str, dict[str, Any]] = {
            "array": {
                "cameras": 1,
                "width_px": 160,
                "height_px": 120,
                "px_per_mm": 10.0,
                "working_distance_mm": 200.0,
                "vignetting": 0.0,
                "psf_px": 0.0,
                "shot_noise": 0.0,
                "read_noise": 0.0,
                "flicker": 0.0,
                "black_level": 0.0,
                "exposures_us": [1.0],
                "reference_exposure_us": 1.0,
            },
            "belt": {"yaw_sigma_deg": 0.0, "offset_sigma_mm": 0.0},
            "board": {"width_mm": 30.0, "length_mm": 20.0, "density": 0.0},
            "line": {"barrier_mm": -10.0, "start_delay_s": 0.1, "period_s": 0.05, "tail_s": 0.1},
        }
        for name, section in sections.items():
            base[name] = {**base.get(name, {}), **section}
        return Twin(Scenario.model_validate(base))

    return twin
