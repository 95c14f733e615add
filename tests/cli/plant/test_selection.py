"""The options by which runs are selected, and the bar of their progress."""

from __future__ import annotations

import pytest

from vaoi_station.cli.plant.selection import progress_bar, run_selection, verdicts_of
from vaoi_station.errors import InputError
from vaoi_station.model import Status


def test_options_become_a_selection() -> None:
    chosen = run_selection("main*", "2026-03-01", None, "line 1", "degraded")
    assert (chosen.board_type, chosen.since, chosen.station, chosen.verdict) == (
        "main*", "2026-03-01", "line 1", Status.DEGRADED,
    )  # fmt: skip
    assert run_selection(None, None, None, None, None).verdict is None


def test_verdicts_are_words() -> None:
    assert verdicts_of("ok, failed") == (Status.OK, Status.FAILED)
    with pytest.raises(InputError, match="one of ok, degraded, failed"):
        verdicts_of("ok,")


def test_the_bar_counts_what_an_earlier_call_has_done(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("runs") as show:
        for done in (3, 4, 5):
            show(done, 5)
    assert "runs" in capsys.readouterr().out
