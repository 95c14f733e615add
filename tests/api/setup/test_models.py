from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.api.setup.models import TrialRequest

LAYOUT = {"mark": {"size": 2, "width": 0.5}, "marks": [{"x": x, "y": y} for x in (0, 1) for y in (0, 1)]}


def test_limits_have_their_defaults_and_bounds() -> None:
    wanted = TrialRequest.model_validate({"run": "r", "row": 0, "layout": LAYOUT})
    assert (wanted.residual_limit_px, wanted.center_tolerance_mm, wanted.working_distance_mm) == (0.2, 2.0, None)
    for wrong in ({"row": -1}, {"residual_limit_px": 0}, {"flatness_um": -1}, {"unknown": 1}):
        with pytest.raises(ValidationError):
            TrialRequest.model_validate({"run": "r", "row": 0, "layout": LAYOUT, **wrong})
