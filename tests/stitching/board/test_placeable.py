"""Board types that no run can place are refused, with words."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.model import BoardType
from vaoi_station.stitching.expectation import refuse_unplaceable

MARKS: list[dict[str, Any]] = [{"name": f"F{n}", "x": 5.0 * n, "y": 1.0, "diameter": 1.0} for n in range(3)]


@pytest.mark.parametrize(("count", "words"), [(0, "0 fiducials"), (1, "1 fiducial,")])
def test_fewer_than_two_fiducials_are_refused(count: int, words: str) -> None:
    with pytest.raises(InputError, match=f"board.json: board type 'b' has {words}.* at least 2") as refusal:
        refuse_unplaceable(BoardType.model_validate({"name": "b", "fiducials": MARKS[:count]}), "board.json")
    assert refusal.value.code == "too-few-fiducials"
    assert "as fiducials" in refusal.value.action


@pytest.mark.parametrize("count", [2, 3])
def test_two_fiducials_are_enough(count: int) -> None:
    refuse_unplaceable(BoardType.model_validate({"name": "b", "fiducials": MARKS[:count]}), "board.json")
