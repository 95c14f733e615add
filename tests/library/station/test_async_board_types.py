"""The board types of a station from a program with asyncio; `test_operations` compares all methods."""

from __future__ import annotations

import asyncio

import vaoi_station as vaoi
from tests.api.conftest import Served


def test_a_method_is_set_and_forgotten(served: Served) -> None:
    async def methods() -> list[str]:
        board_types = (await vaoi.connect_async(served.url)).board_types
        set_for_it = await board_types.set_method("demo-board", "features")
        return [set_for_it.method, (await board_types.forget_method("demo-board")).chosen]

    assert asyncio.run(methods()) == ["features", "station"]
