"""Faults on the command line."""

from __future__ import annotations

import pytest

from vaoi_station.errors import InputError
from vaoi_station.rig.faults import parse_fault, with_belt_faults
from vaoi_station.simulation import Scenario


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("fire", "--fault is 'fire', but must be one of loss, kill"),
        ("loss:camera=1", "--fault loss is 'camera=1', but must be KEY=VALUE, KEY one of share"),
        ("loss:share=much", "share is 'much', but must be a number"),
        ("loss:share=1.5", "share is 1.5, but must be from 0 to 1"),
        ("kill:row=1.5", "row is '1.5', but must be a whole number"),
        ("kill:row=-1", "row is -1, but must be at least 0"),
        ("kill:for_s=0", "for_s is 0.0, but must be above 0, at most 60 s"),
        ("stall:who=camera", "who is 'camera', but must be station, acquisition, or worker N"),
        ("stall:who=", "who is '', but must be station, acquisition, or worker N"),
        ("stall:who=worker x", "who is 'worker x', but must be station, acquisition, or worker N"),
        ("follow:gap_mm=0", "gap_mm is 0.0, but must be above 0, at most 10000 mm"),
        ("follow:count=0", "count is 0, but must be from 1 to 20"),
        ("stamps:by_s=nan", "by_s is nan, but must be above 0, at most 60 s"),
        ("bounce:at_s=-1", "at_s is -1.0, but must be from 0 to 60 s"),
        ("bounce:at_s=nan", "at_s is nan, but must be from 0 to 60 s"),
        ("kill:camera=1,camera=2", "is 'kill:camera=1,camera=2', but must be written with camera once"),
    ],
)
def test_an_invalid_fault_is_refused(text: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        parse_fault(text)


def test_the_twin_plays_what_happens_on_the_belt() -> None:
    faults = [parse_fault(t) for t in ("stuck:board=2,row=5", "bounce:board=0,at_s=0.1,for_s=0.002", "loss")]
    known = with_belt_faults(Scenario(), faults).faults
    assert [(f.board, f.row) for f in known.stuck] == [(2, 5)]
    assert [(f.board, f.at_s, f.duration_s) for f in known.bounces] == [(0, 0.1, 0.002)]
