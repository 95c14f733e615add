"""Heights as a worker measures them."""

from __future__ import annotations

import json
import pickle

import pytest

from tests.heights.conftest import make_film
from vaoi_station.runs.workers.heights_job import HeightsJob


def test_a_job_can_be_sent_to_a_worker_and_its_reply_is_the_document_of_heights() -> None:
    filmed = make_film({"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5)}, rows=2)
    slots = {(0, 0): 7, (0, 1): 8}
    job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), slots)
    sent: HeightsJob = pickle.loads(pickle.dumps(job))
    assert str(sent) == "the heights of components of run r1"
    content = sent.perform(lambda slot: filmed.frames[0, slot - 7])
    entry = json.loads(content)["heights"]["U1"]
    assert entry["height_mm"] == pytest.approx(1.5, abs=0.1)
    assert entry["views"] == 2
    assert entry["comparison"] == "agrees"
