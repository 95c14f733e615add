"""Splits are by board, stable, and have their shares."""

from __future__ import annotations

from collections import Counter

import pytest

from vaoi_station.errors import InputError
from vaoi_station.plant.datasets.splits import DEFAULT, Splits


def test_boards_are_shared_out_as_stated() -> None:
    splits = Splits.of(DEFAULT)
    counts = Counter(splits.of_board(f"board {n}") for n in range(4000))
    assert counts["train"] == pytest.approx(3200, abs=100)
    assert counts["val"] == pytest.approx(400, abs=70)
    assert {splits.of_board("board 7") for _ in range(3)} == {Splits.of(DEFAULT).of_board("board 7")}


@pytest.mark.parametrize(
    "text", ["", "train", "train=0", "train=a", "a=0.5,a=0.5", "train=0.8,val=0.1", "a/b=1", "annotations=1"]
)
def test_wrong_shares_are_refused(text: str) -> None:
    with pytest.raises(InputError, match="--splits"):
        Splits.of(text)
