"""Size of marks in frames from calibration, configuration or option; incomplete descriptions are refused."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.files import write_calibration
from vaoi_station.model import Calibration
from vaoi_station.viewing.mark_spec import mark_specs

Make = Callable[..., StationConfig]


def test_without_options_no_marks_are_searched(make_config: Make) -> None:
    assert mark_specs(make_config(), None, None, None, None) == (None, None)


def test_the_size_in_pixels_follows_from_the_resolution(make_config: Make) -> None:
    config = make_config(nominal_px_per_mm=10.0)
    assert [s.size_px for s in mark_specs(config, "cross", 2.4, None, None) if s] == [24.0, 24.0]
    assert [s.size_px for s in mark_specs(config, "cross", 2.4, None, 20.0) if s] == [48.0, 48.0]
    matrices = [[[8.0, 0, -60.0 * i], [0, 8.0, 0], [0, 0, 1]] for i in range(2)]
    document = {"format": "vaoi-calibration", "version": 1, "unit": "mm", "camera_matrices": matrices}
    write_calibration(config.calibration, Calibration.model_validate(document))
    sizes = [s.size_px for s in mark_specs(config, "cross", 2.5, None, None) if s]
    assert sizes == pytest.approx([20.0, 20.0]), "a calibration knows better than the design"


def test_a_layout_defines_the_marks(make_config: Make, layout: Path) -> None:
    config = make_config(nominal_px_per_mm=10.0, nominal_center_mm=(0.0, 0.0))
    spec = mark_specs(config, None, None, layout, None)[0]
    assert spec is not None
    assert (spec.shape, spec.size_px, spec.arm, spec.light, spec.expected) == ("cross", 24.0, 0.25, False, 4)
    far = mark_specs(make_config(nominal_px_per_mm=10.0, nominal_center_mm=(90.0, 0.0)), None, None, layout, None)[0]
    assert far is not None
    assert far.expected == 0
    unknown = mark_specs(make_config(nominal_px_per_mm=10.0), None, None, layout, None)[0]
    assert unknown is not None
    assert unknown.expected is None


def test_an_incomplete_description_is_refused(make_config: Make, layout: Path) -> None:
    config = make_config()
    with pytest.raises(InputError, match="--mark-size-mm is missing"):
        mark_specs(config, "cross", None, None, None)
    with pytest.raises(InputError, match="--mark is missing"):
        mark_specs(config, None, 2.0, None, None)
    with pytest.raises(InputError, match="--layout already defines the marks"):
        mark_specs(config, "cross", None, layout, None)
    with pytest.raises(InputError, match=r"cameras\.0\.nominal_px_per_mm is missing and there is no calibration"):
        mark_specs(config, "cross", 2.0, None, None)
    with pytest.raises(InputError, match=r"size of a mark is '2\.0 px', but must be at least"):
        mark_specs(config, "cross", 0.2, None, 10.0)
