"""Requests for batches: the components that they mean, and what is refused."""

from __future__ import annotations

from typing import Any

import pytest

from tests.api.held_station import BOARD
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model import BoardType
from vaoi_station.rendering import ImageRequest
from vaoi_station.runs.batches.batches import BatchRequest, smallest

BOARD_TYPE = BoardType.model_validate(BOARD)


def addresses(**fields: Any) -> list[str]:
    return [part.address for part in BatchRequest(**fields).check().parts(BOARD_TYPE, 8.0)]


def test_components_of_a_request() -> None:
    assert addresses() == ["U1", "R1", "2/R1"]
    assert addresses(components=("2/R1", "U1", "2/R1")) == ["2/R1", "U1"]
    assert addresses(within=(25, 0, 60, 40)) == ["R1", "2/R1"]
    assert addresses(region=(0, 0, 10, 10)) == ["region"]
    assert smallest(BOARD_TYPE.components).ref == "R1"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"components": ("U1",), "within": (0, 0, 1, 1)}, "components and within are given together"),
        ({"container": "rar"}, "container is 'rar'"),
        ({"format": "gif"}, "format is 'gif'"),
        ({"hdr": True, "images": ImageRequest.of({"limit": 1})}, "limit has no meaning with hdr"),
        ({"within": (0, 0, 1, 1)}, "within is '0 0 1 1', but must be a box"),
        ({"region": (5, 5, 5, 9)}, "batch: region"),
    ],
)
def test_what_contradicts_itself_is_refused(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        addresses(**fields)


def test_an_unknown_component_is_refused() -> None:
    with pytest.raises(NotFoundError, match="no component 'U9'"):
        addresses(components=("U1", "U9"))
