"""Jobs of mosaics: pickled to a worker, performed there, encoded or as pixels."""

from __future__ import annotations

import pickle
from typing import Any

import cv2
import numpy as np

from tests.mosaic.conftest import Film, Filmed, board, film
from vaoi_station.mosaic import MosaicPlan, TileRenderer, choose_frames
from vaoi_station.runs.workers.mosaic_jobs import PlanJob, PlannedPicture, TileJob, displayed
from vaoi_station.runs.workers.worker import Queued

__all__ = ["board", "film"]


def planned(board: Filmed, *, hdr: bool = False) -> tuple[MosaicPlan, dict[tuple[int, int], int]]:
    slots = {(f.camera, f.row): n for n, f in enumerate(board.taken)}
    choice = choose_frames(board.taken, hdr=hdr)
    job = PlanJob("r", 0, 1, slots, choice, board.cameras, board.stitch, board.board_type, board.base, board.base)
    sent: PlanJob = pickle.loads(pickle.dumps(job))
    keys = list(slots)
    planned: PlannedPicture = pickle.loads(pickle.dumps(sent.perform(lambda slot: board.frames[keys[slot]])))
    assert (planned.reduction, planned.picture is None) == (1, hdr)
    return planned.plan, slots


def tile(board: Filmed, format: str | None, *, hdr: bool = False) -> Any:
    plan, slots = planned(board, hdr=hdr)
    spec = TileRenderer(plan, board.projector, board.base).spec((0, 0, 256, 256))
    job: TileJob = pickle.loads(pickle.dumps(TileJob("r", 0, 1, slots, spec, plan.tone, format)))
    keys = list(slots)
    return job.perform(lambda slot: board.frames[keys[slot]])


def decoded(content: bytes) -> Any:
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)


def test_a_plan_takes_one_worker_only(board: Filmed) -> None:
    """It takes seconds for some hundred frames: another worker would have to begin anew."""
    base, choice = board.base, choose_frames(board.taken)
    job = PlanJob("r", 0, 1, {}, choice, board.cameras, board.stitch, board.board_type, base, base)
    assert not Queued(job).repeatable


def test_plan_and_tile_travel_to_a_worker_and_back(board: Filmed) -> None:
    pixels = tile(board, None)
    png = decoded(tile(board, "png"))
    np.testing.assert_array_equal(png, pixels)
    jpeg = decoded(tile(board, "jpg"))
    assert np.abs(jpeg.astype(int) - pixels).mean() < 3


def test_hdr_is_shown_by_its_logarithm(film: Film) -> None:
    run = film(exposures=(250.0, 50.0), step_mm=6.0)
    radiance = tile(run, None, hdr=True)
    shown = decoded(tile(run, "png", hdr=True))
    assert shown.dtype == np.uint8
    assert (np.isfinite(radiance) == (shown > 0)).all()
    tones = displayed(np.array([[1, 10, 100, np.nan]], np.float32), (1.0, 100.0))
    assert tones.tolist() == [[1, 128, 255, 0]]


def test_tile_that_no_frame_shows_is_black(board: Filmed) -> None:
    plan, _ = planned(board)
    spec = TileRenderer(plan, board.projector, board.base).spec((0, 0, 64, 64))
    content = TileJob("r", 0, 1, {}, spec, plan.tone, "png").perform(lambda slot: board.frames[0, 0])
    assert isinstance(content, bytes)
    assert (decoded(content) == 0).all()
