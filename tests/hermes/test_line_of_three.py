"""Through revokes, breaks, restarts, boards that are missed or taken off, each board keeps its id or has none."""

from __future__ import annotations

import pytest

from tests.hermes.line_of_three import Line


@pytest.mark.parametrize("seed", [1, 2])
def test_every_board_has_its_own_id_or_none(seed: int) -> None:
    score = Line(seed, boards=300).run()
    assert not score.wrong
    assert not score.stuck
    assert score.counts["passed with its id"] > 200
    assert score.restarts
