"""Simulated recordings through the public API."""

from __future__ import annotations

from pathlib import Path

import pytest

import vaoi_station as vaoi


def test_a_recording_is_never_overwritten(recording: vaoi.RecordedRun) -> None:
    with pytest.raises(vaoi.InputError, match="already holds a recording"):
        vaoi.simulate("small", recording.directory)


def test_a_negative_board_and_an_unknown_scenario_are_refused(tmp_path: Path) -> None:
    with pytest.raises(vaoi.InputError, match="board is -1"):
        vaoi.simulate("small", tmp_path, board=-1)
    with pytest.raises(vaoi.VaoiError, match="absent"):
        vaoi.simulate("absent", tmp_path)
    assert not list(tmp_path.iterdir()), "nothing is left behind"
