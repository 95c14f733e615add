"""The mosaics of a run: which there are, and plans that are made once though many callers ask."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.mosaic.conftest import Film, Filmed, board, film
from tests.runs.finished import held_run
from tests.runs.mosaics.test_opened_mosaics import means
from vaoi_station.errors import BusyError, DeviceError
from vaoi_station.model import CameraHead, FrameRecord, Verdict
from vaoi_station.model.stitch_result import Heights
from vaoi_station.mosaic import MosaicPlan, TileRenderer
from vaoi_station.mosaic.tiles import render_tile
from vaoi_station.runs.mosaics.mosaics import Download, Mosaics
from vaoi_station.runs.mosaics.opened_mosaics import PictureName
from vaoi_station.runs.workers import picture_jobs
from vaoi_station.runs.workers.picture_jobs import PlanJob, TileJob

__all__ = ["board", "film"]


def mosaics_of(
    board: Filmed,
    jobs: list[Any],
    started: threading.Event | None = None,
    flat_fields: Path | None = None,
    heights: Callable[[str], Heights | None] = lambda run: None,
    hastened: Callable[[Any, str], Any] = lambda kind, run: nullcontext(),
    own: Callable[[TileJob], bytes | None] = lambda job: None,
) -> Mosaics:
    """Mosaics of the run "r1", whose jobs are performed at once and are noted in `jobs`."""
    keys = [(f.camera, f.row) for f in board.taken]
    frames = tuple(
        FrameRecord(
            camera=f.camera, row=f.row, verdict=Verdict.OK, slot=n, exposure_us=f.exposure_us, light=f.light or ""
        )
        for n, f in enumerate(board.taken)
    )
    finished = held_run(
        detail=SimpleNamespace(id="r1", frames=frames, frames_available=True, bay=0, generation=1),
        board_type=board.board_type,
        cameras=board.cameras,
        stitch=board.stitch,
        head=SimpleNamespace(
            cameras=[CameraHead(width=e.width_px, height=e.height_px, exposure_us=250.0) for e in board.cameras], rows=0
        ),
    )

    def render(job: Any, name: str) -> Any:
        jobs.append(job)
        if started is not None:
            assert started.wait(30)
        return job.perform(lambda slot: board.frames[keys[slot]])

    archive = SimpleNamespace(get=lambda run: finished, explained=lambda run: finished)

    def held(run: str, purpose: str) -> Any:
        return nullcontext(SimpleNamespace(number=0, generation=1))

    return Mosaics(archive, held, render, flat_fields, heights, hastened, own=own)  # type: ignore[arg-type]


def planned(mosaics: Mosaics, *, hdr: bool = False) -> MosaicPlan:
    """Return the plan of a mosaic, after a tile was made by it."""
    name = PictureName(hdr=hdr)
    mosaics.tile("r1", name, 1, (0, 0, 8, 8), "png")
    made = mosaics._open("r1", name, asked=True).planned
    assert made is not None
    return made.plan


def test_lights_and_exposures_have_mosaics(film: Film) -> None:
    run = film(exposures=(250.0, 50.0), lights=("even", "even", "left", "left"))
    assert list(map(str, mosaics_of(run, []).names("r1"))) == [
        "board",
        "board,light=even",
        "board,light=even,exposure=250",
        "board,light=even,exposure=50",
        "board,light=even,hdr",
        "board,light=left",
        "board,light=left,exposure=250",
        "board,light=left,exposure=50",
        "board,light=left,hdr",
    ]


def test_plan_is_made_once_though_several_callers_ask(board: Filmed) -> None:
    jobs: list[Any] = []
    may_go = threading.Event()
    mosaics = mosaics_of(board, jobs, may_go)
    contents: list[bytes] = []
    callers = [
        threading.Thread(target=lambda: contents.append(mosaics.tile("r1", PictureName(), 1, (0, 0, 64, 64), "png")))
        for _ in range(3)
    ]
    for caller in callers:
        caller.start()
    may_go.set()
    for caller in callers:
        caller.join(60)
    assert len(set(contents)) == 1
    assert sum(isinstance(job, PlanJob) for job in jobs) == 1


def _plan(board: Filmed) -> Any:
    from tests.mosaic.test_plan import plan_of

    return plan_of(board)


def test_a_file_without_room_is_refused_with_numbers(
    board: Filmed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    total = shutil.disk_usage(tmp_path).total
    monkeypatch.setattr("vaoi_station.runs.mosaics.mosaics.LEFT_FREE", total)
    with pytest.raises(DeviceError, match=r"the file takes \d+ MB while it is written, \d+ MB are free") as refused:
        mosaics_of(board, []).write("r1", PictureName(), Download(None, 4.0), tmp_path / "b.tif")
    assert refused.value.code == "disk-full"
    assert list(tmp_path.iterdir()) == []


def test_one_large_file_is_made_at_a_time(board: Filmed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("vaoi_station.runs.mosaics.mosaics.LARGE_PX", 100)
    began, may_go, whole = threading.Event(), threading.Event(), Download(None, 4.0)

    class Jobs(list[Any]):
        def append(self, job: Any) -> None:
            super().append(job)
            began.set()

    mosaics = mosaics_of(board, Jobs(), may_go)
    first = threading.Thread(target=mosaics.write, args=("r1", PictureName(), whole, tmp_path / "a.tif"))
    first.start()
    assert began.wait(30)
    with pytest.raises(BusyError, match="there is one at a time"):
        mosaics.write("r1", PictureName(), whole, tmp_path / "b.tif")
    may_go.set()
    first.join(60)
    mosaics.write("r1", PictureName(), whole, tmp_path / "b.tif")
    assert (tmp_path / "a.tif").read_bytes() == (tmp_path / "b.tif").read_bytes()


@contextmanager
def spare(run: str, purpose: str) -> Iterator[Any]:
    yield SimpleNamespace(number=0, generation=1)


def decoded(content: bytes) -> NDArray[Any]:
    return np.asarray(cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED))


@pytest.mark.parametrize("finest", [2, 8])
@pytest.mark.parametrize("reduction", [8, 32])
@pytest.mark.parametrize(("dtype", "channels"), [(np.uint8, 1), (np.uint16, 1), (np.uint8, 3)])
def test_reduced_tiles_are_cut_from_the_overview(
    film: Film, monkeypatch: pytest.MonkeyPatch, finest: int, reduction: int, dtype: Any, channels: int
) -> None:
    """They are compared with the means of the whole picture: in the median within one grey level, and no farther off
    than tiles that are rendered from frames, which differ where their reduced pixels lie between those of the tile."""
    jobs: list[Any] = []
    run = film(dtype=dtype, channels=channels)
    mosaics = mosaics_of(run, jobs)
    name, whole = PictureName(), mosaics.grid("r1", PictureName())
    monkeypatch.setattr(picture_jobs, "OVERVIEW_PX", whole.width * whole.height // finest**2)
    grid, unit = whole.reduced(reduction), 1 if dtype == np.uint8 else 257
    box = 0, 0, grid.width, grid.height
    largest = decoded(mosaics.tile("r1", name, 1, (0, 0, whole.width, whole.height), "png"))
    before = len(jobs)
    cut = decoded(mosaics.tile("r1", name, reduction, box, "png"))
    assert len(jobs) == before, "no worker is asked"
    planned = mosaics._open("r1", name, asked=True).planned
    assert planned is not None
    assert planned.overview is not None
    assert planned.overview.reduction == finest
    rendered = render_tile(TileRenderer(planned.plan, run.projector, grid).spec(box), run.read)
    assert rendered is not None
    assert (cut.shape, cut.dtype) == (rendered.shape, rendered.dtype)
    truth = means(largest, reduction)[:-1, :-1] / unit
    differ, rendered_differ = (np.abs(picture[:-1, :-1] / unit - truth) for picture in (cut, rendered))
    assert np.median(differ) <= 1
    assert np.percentile(differ, 95) <= max(1.1 * np.percentile(rendered_differ, 95), 1)
