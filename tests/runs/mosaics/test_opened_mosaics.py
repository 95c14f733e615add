"""Mosaics in memory: no more plans and bytes of overviews than the limits allow."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from vaoi_station.runs.mosaics.opened_mosaics import (
    MOST_AHEAD,
    MOST_BYTES,
    MOST_PLANS,
    OpenedMosaic,
    OpenedMosaics,
    PlannedMosaic,
)


def opened() -> OpenedMosaic:
    anything: Any = SimpleNamespace()
    return OpenedMosaic(anything, anything, {})


def planned(share: float) -> PlannedMosaic:
    """A plan with an overview that takes a share of the memory for all."""
    anything: Any = SimpleNamespace(nbytes=int(share * MOST_BYTES))
    return PlannedMosaic(anything, anything)


def test_the_mosaics_that_were_used_last_are_kept() -> None:
    mosaics = OpenedMosaics()
    for n in range(MOST_PLANS):
        mosaics.use(n, opened(), asked=True)
    first = mosaics.get(0)
    assert first is not None
    assert mosaics.use(0, opened(), asked=True) is first
    mosaics.use("new", opened(), asked=True)
    assert [mosaics.get(n) is not None for n in (0, 1, "new")] == [True, False, True]
    assert len(mosaics) == MOST_PLANS


def test_boards_that_pass_displace_none_that_was_asked_for() -> None:
    mosaics = OpenedMosaics()
    mosaics.use("seen", opened(), asked=True)
    for n in range(2 * MOST_PLANS):
        mosaics.use(n, opened(), asked=False)
    assert mosaics.get("seen") is not None
    assert [n for n in range(2 * MOST_PLANS) if mosaics.get(n)] == [*range(2 * MOST_PLANS)][-MOST_AHEAD:]


def test_overviews_share_a_limit_of_memory() -> None:
    mosaics = OpenedMosaics()
    used = [mosaics.use(n, opened(), asked=True) for n in range(4)]
    for one in used[:3]:
        mosaics.keep(one, planned(0.4))
    assert [mosaics.get(n) is not None for n in range(4)] == [False, True, True, True]
    mosaics.keep(used[3], planned(1.2))
    assert [mosaics.get(n) is not None for n in range(4)] == [False, False, False, True]
