"""Jobs on the frames of a finished run, as a worker performs them: pickled to it, and performed there."""

from __future__ import annotations

import io
import json
import pickle
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.api.held_station import BOARD, HeldStation
from tests.board_check.conftest import drawn_board, drawn_run
from tests.hdr.exposed_views import FRAME, SIZE, view
from tests.heights.conftest import make_film
from tests.identity.conftest import DATAMATRIX
from tests.identity.conftest import film as coded
from tests.mosaic.conftest import Film, Filmed, board, film
from tests.runs.merging.finished_board import Merging, even_fields
from vaoi_station.files.images import decode, write_image
from vaoi_station.heights.estimates import combine_parts
from vaoi_station.model import BoardType
from vaoi_station.mosaic import MosaicPlan, TileRenderer, choose_frames
from vaoi_station.photometry import Taken
from vaoi_station.photometry.flat_fields import FlatFieldDocument, FlatFields, write_flat_fields
from vaoi_station.runs.merging.merged_pictures import level_frames
from vaoi_station.runs.workers import picture_jobs
from vaoi_station.runs.workers.jobs import Priority
from vaoi_station.runs.workers.picture_jobs import (
    BoardCheckJob,
    CombineHeightsJob,
    HeightsJob,
    IdentityJob,
    IdentitySlice,
    MergedFrame,
    MergeJob,
    PlanJob,
    PlannedPicture,
    RowLevelsJob,
    TileJob,
    displayed,
)


def test_a_job_can_be_sent_and_yields_report_and_picture() -> None:
    board = drawn_board(count=12)
    run = drawn_run(board)
    job = BoardCheckJob("r1", 0, 1, {(0, 0): 5}, run.stitch, run.cameras, (), board, board)
    sent: BoardCheckJob = pickle.loads(pickle.dumps(job))
    assert sent.priority is Priority.HEIGHTS
    assert (sent.repeatable, sent.longest_s) == (False, 180.0)
    assert str(sent) == "the check of board type 'drawn' against run r1"
    slots: list[int] = []

    def frame(slot: int) -> np.ndarray:
        slots.append(slot)
        pixels = run.frame(0, 0)
        assert pixels is not None
        return pixels

    found = sent.perform(frame)
    assert set(slots) == {5}
    assert found.report.residual is not None
    assert found.report.proposal is None
    picture = decode(found.picture)
    assert picture is not None
    assert picture.ndim == 3


PARTS = {"U1": ((0.0, 0.0, 3.0, 2.5), 1.0, 1.5), "U2": ((4.0, 0.0, 3.0, 2.5), 1.0, 0.8)}
SLOTS = {(0, 0): 7, (0, 1): 8}


def test_slices_and_their_combination_can_be_sent_to_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_jobs, "SLICE_S", -1.0)
    filmed = make_film(PARTS, rows=2)
    job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS)
    sent: HeightsJob = pickle.loads(pickle.dumps(job))
    assert str(sent) == "heights of components of run r1"
    first = sent.perform(lambda slot: filmed.frames[0, slot - 7])
    assert list(first) == ["U1"], "the time is over after one component"
    rest = filmed.board_type.model_copy(update={"components": filmed.board_type.components[1:]})
    second = HeightsJob("r1", 0, 1, rest, filmed.stitch, filmed.cameras, (), SLOTS)
    parts = {**first, **second.perform(lambda slot: filmed.frames[0, slot - 7])}
    combined = CombineHeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, parts)
    last: CombineHeightsJob = pickle.loads(pickle.dumps(combined))
    assert str(last) == "the table of heights of run r1"
    heights = json.loads(last.perform(lambda slot: filmed.frames[0, slot]))["heights"]
    assert heights["U1"]["height_mm"] == pytest.approx(1.5, abs=0.1)
    assert heights["U1"]["views"] == 2
    assert heights["U1"]["comparison"] == "agrees"
    assert set(heights) == {"U1", "U2"}


def test_frames_are_divided_by_the_flat_fields(tmp_path: Path) -> None:
    """A pattern that stays where it is in the frames hides how far the tops of bodies move."""
    filmed = make_film(PARTS, rows=2)
    (camera,) = filmed.cameras
    x, y = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    shade = (0.6 + 0.2 * np.sin(0.5 * x) + 0.2 * np.sin(0.7 * y)).astype(np.float32)
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "cameras": [{"width": camera.width_px, "height": camera.height_px, "read": 1.0, "shot": 0.02}],
        "fields": [{"camera": 0, "file": "fields/0.tiff", "level": 1.0, "rows": 4}],
    }
    write_flat_fields(tmp_path, FlatFields(FlatFieldDocument.model_validate(document), {(0, None): shade}))
    shaded = [np.round(filmed.frames[0, row] * shade).astype(np.uint8) for row in range(2)]

    def measured(fields: Path | None) -> dict[str, float | None]:
        job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS, fields)
        parts = pickle.loads(pickle.dumps(job)).perform(lambda slot: shaded[slot - 7])
        return {ref: found.height_mm for ref, found in combine_parts(parts, filmed.stitch).items()}

    truth = {ref: height_mm for ref, (_, _, height_mm) in PARTS.items()}
    assert measured(tmp_path) == pytest.approx(truth, abs=0.1)
    assert measured(None) != pytest.approx(truth, abs=0.1)


def test_a_slice_uses_the_frames_that_it_has_converted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else each slice would convert the frames again, and measure one component."""
    filmed, now_s = make_film(PARTS, rows=2), [0.0]
    monkeypatch.setattr(picture_jobs, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    read: list[int] = []

    def frame(slot: int) -> Any:
        read.append(slot)
        now_s[0] += 10 * picture_jobs.SLICE_S
        return filmed.frames[0, slot - 7]

    job = HeightsJob("r1", 0, 1, filmed.board_type, filmed.stitch, filmed.cameras, (), SLOTS)
    assert list(job.perform(frame)) == ["U1", "U2"]
    assert sorted(read) == [7, 8]


def test_slices_can_be_sent_to_a_worker_and_continue(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(picture_jobs, "SLICE_S", -1.0)
    filmed = coded((DATAMATRIX,))
    numbers = {key: number for number, key in enumerate(filmed.frames)}
    frames = {number: filmed.frames[key] for key, number in numbers.items()}
    job = IdentityJob(
        "r1", 0, 1, filmed.with_identity(places=(), pattern="other{id}"), filmed.stitch, filmed.cameras, numbers
    )
    slices: list[IdentitySlice] = []
    while not slices or not slices[-1].progress.ended:
        sent: IdentityJob = pickle.loads(pickle.dumps(job))
        assert (str(sent), sent.priority) == ("the codes of run r1", Priority.IDENTITY)
        slices.append(pickle.loads(pickle.dumps(sent.perform(frames.__getitem__))))
        job = replace(job, progress=slices[-1].progress)
    assert len(slices) > 1
    assert [code.text for code in slices[-1].reading.codes] == list(filmed.texts)
    assert slices[-1].reading.complete
    assert slices[0].worker_s > 0


def job(**options: object) -> MergeJob:
    shown = view(0, 0, (12.0, 9.0))
    frames = tuple(MergedFrame(shown, Taken(exposure), FRAME, slot) for slot, exposure in enumerate((100.0, 10.0)))
    return MergeJob("r1", 0, 1, 0, shown, "npy", frames=frames, **options)  # type: ignore[arg-type]


def test_frames_of_the_ring_are_merged() -> None:
    pixels = {0: np.full(FRAME[::-1], 255, np.uint8), 1: np.full(FRAME[::-1], 60, np.uint8)}
    merged = pickle.loads(pickle.dumps(job()))
    value = np.load(io.BytesIO(merged.perform(pixels.__getitem__)))
    assert value.shape == SIZE[::-1]
    np.testing.assert_allclose(value, 6.0, rtol=1e-5)
    sigma = np.load(io.BytesIO(job(sigma=True).perform(pixels.__getitem__)))
    assert 0 < sigma.max() < 1


def test_levels_follow_from_the_ring_and_from_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The lamp's level of each row, up to one factor per light, since their mean is 1."""
    station = HeldStation()
    fields = even_fields(tmp_path / "fields", station.cameras)
    board_type = BoardType.model_validate(BOARD)
    made = Merging(board_type, station.stitch(station.film()), station.cameras, fields, 0.08)
    rows, finished = len(made.levels), made.finished
    frames = level_frames(finished.detail.frames)
    job = RowLevelsJob("r1", 1, 7, frames, board_type, finished.stitch, station.cameras, fields)
    found = pickle.loads(pickle.dumps(job)).perform(made.pixels.__getitem__)
    for light in (0, 1):
        mine, true = found[light::2], made.levels[light::2]
        np.testing.assert_allclose(mine / np.exp(np.log(mine).mean()), true / np.exp(np.log(true).mean()), atol=0.012)
    for slot, pixels in made.pixels.items():
        write_image(tmp_path / f"{slot}.png", pixels)
    filed = tuple(f._replace(file=tmp_path / f"{f.camera * rows + f.row}.png") for f in frames)
    recorded = RowLevelsJob("r1", 0, 0, filed, board_type, finished.stitch, station.cameras, fields, recorded=True)
    np.testing.assert_array_equal(recorded.perform(lambda _: np.zeros(0)), found)
    monkeypatch.setattr(picture_jobs, "MOST_DECODED", 1000)
    np.testing.assert_array_equal(recorded.perform(lambda _: np.zeros(0)), 1.0)
    np.testing.assert_array_equal(job.perform(made.pixels.__getitem__), found)
    assert str(job) == "the brightness of the rows of run r1"


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
