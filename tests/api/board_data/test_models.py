from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.api.board_data.models import ImportOptions


def test_options_are_checked() -> None:
    assert ImportOptions().side == "top"
    for wrong in ({"units": "cm"}, {"join": "../x"}, {"format": "gerber"}, {"nonsense": 1}):
        with pytest.raises(ValidationError):
            ImportOptions.model_validate(wrong)
