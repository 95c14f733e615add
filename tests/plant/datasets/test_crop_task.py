"""A task returns all crops of a run with what stands for its board."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.errors import StateError
from vaoi_station.model import Status
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.datasets import CropOptions
from vaoi_station.plant.datasets.crop_task import CropTask, board_key, crop_run, crops_from
from vaoi_station.plant.workers.run_work import RunFault
from vaoi_station.plant.workers.software import software


def task_of(archive: Archive, run: str) -> CropTask:
    found = archive.run(run)
    return CropTask(archive.url, found.key, found.digest, 0, software(), CropOptions(("U1",)), (Status.OK,))


def test_crops_come_back_from_a_worker(boards: Archive) -> None:
    content = crop_run(task_of(boards, "r1"))
    assert isinstance(content, bytes)
    found = crops_from(content)
    assert found.board == "board B1"
    assert found.crops
    assert {crop.facts["component"] for crop in found.crops} == {"U1"}
    assert found.crops[0].pixels.shape == (found.crops[0].facts["height_px"], found.crops[0].facts["width_px"])


def test_a_run_of_another_verdict_has_no_crops(boards: Archive) -> None:
    content = crop_run(task_of(boards, "bad"))
    assert isinstance(content, bytes)
    assert crops_from(content) == ("run line 9/bad", None)


def test_a_run_without_an_id_of_its_board_is_a_board_of_its_own(boards: Archive) -> None:
    assert board_key(boards.run("bad")) == "run line 9/bad"


def test_what_cannot_be_done_is_named(boards: Archive) -> None:
    task = task_of(boards, "r1")
    replaced = crop_run(replace(task, manifest="0" * 16))
    assert isinstance(replaced, RunFault)
    assert "was replaced after the run was selected" in replaced.message
    with pytest.raises(StateError, match="but must have vaoi_station 0"):
        crop_run(replace(task, software="vaoi_station 0"))
