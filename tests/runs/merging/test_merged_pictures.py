from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.api.held_station import BOARD, CAMERAS, HeldStation
from tests.photometry.white_recordings import film, white
from tests.runs.merging.finished_board import RADIANCE, Merging
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model import BoardType
from vaoi_station.photometry.flat_fields import write_flat_fields
from vaoi_station.photometry.measurement import measure_flat_fields
from vaoi_station.runs.merging.merged_pictures import MergeRequest


@pytest.fixture
def merging() -> Merging:
    return make()


def make(flat_fields: Path | None = None, metal: float = 1.0) -> Merging:
    station = HeldStation()
    run = station.film()
    return Merging(BoardType.model_validate(BOARD), station.stitch(run), station.cameras, flat_fields, metal=metal)


def array(content: bytes) -> Any:
    return np.load(io.BytesIO(content))


def test_frames_of_all_exposures_are_merged_to_radiance(merging: Merging) -> None:
    wanted = MergeRequest("U1")
    choices = merging.access.pictures("r1", wanted)
    assert choices[-1].exposures == 2
    assert len(choices[-1].frames) == max(len(c.frames) for c in choices) > CAMERAS
    assert (0, 1) not in {(f.view.camera, f.view.row) for c in choices for f in c.frames}
    value = array(merging.access.image("r1", wanted, None, "npy"))
    assert value.shape == (choices[-1].view.height, choices[-1].view.width)
    np.testing.assert_allclose(value[np.isfinite(value)], RADIANCE, rtol=0.01)
    sigma = array(merging.access.image("r1", wanted, 0, "npy", sigma=True))
    assert 0 < float(sigma.min()) < 0.05
    assert [f.slot for f in merging.jobs[0].frames] == [f.slot for f in choices[-1].frames]
    assert (merging.jobs[0].bay, merging.jobs[0].generation) == (1, 7)
    assert "merged of" in str(merging.jobs[0])


@pytest.mark.parametrize(("light", "shown", "brighter"), [(None, "even", 1.0), ("left", "left", 0.2)])
def test_frames_of_one_light_are_merged(light: str | None, shown: str, brighter: float) -> None:
    """Metal is dark under the light from the left: a mean of both would be the radiance under neither."""
    merging = make(metal=0.2)
    wanted = MergeRequest("U1", light=light)
    for choice in merging.access.pictures("r1", wanted):
        assert {f.taken.light for f in choice.frames} == {shown}
    value = array(merging.access.image("r1", wanted, None, "npy"))
    np.testing.assert_allclose(value[np.isfinite(value)], RADIANCE * brighter, rtol=0.01)


def test_a_region_has_its_bodies_in_the_planes_of_their_tops(merging: Merging) -> None:
    """Each by those frames of the picture that show it."""
    board_type = merging.finished.board_type
    (u1, *others) = board_type.components
    solid = u1.model_copy(update={"body_height": 1.5})
    merging.finished.board_type = board_type.model_copy(update={"components": (solid, *others)})
    corners = board_type.footprint(u1)
    low, high = (corners.min(0) - 1).tolist(), (corners.max(0) + 1).tolist()
    wanted = MergeRequest(region=(low[0], low[1], high[0], high[1]), px_per_mm=4)
    value = array(merging.access.image("r1", wanted, None, "npy"))
    np.testing.assert_allclose(value[np.isfinite(value)], RADIANCE, rtol=0.01)
    job = merging.jobs[0]
    (body,) = job.bodies
    assert body.body.height_mm == 1.5
    assert {f.view.height_mm for f in body.frames} == {1.5}
    assert {(f.view.camera, f.view.row) for f in body.frames} <= {(f.view.camera, f.view.row) for f in job.frames}
    merging.access.image("r1", MergeRequest("U1"), None, "npy")
    assert merging.jobs[1].bodies == ()


@pytest.mark.parametrize(
    ("wanted", "error", "message"),
    [
        (MergeRequest(), InputError, "exactly one of component and region"),
        (MergeRequest("U1", (0, 0, 1, 1)), InputError, "exactly one of component and region"),
        (MergeRequest("U9"), NotFoundError, "no component 'U9'"),
        (MergeRequest("U1", light="blue"), NotFoundError, "No usable frame of run r1 under the light 'blue' shows U1"),
        (MergeRequest(region=(100, 100, 101, 101)), InputError, "must be on the board"),
        (MergeRequest(region=(0, 0, 60, 40), px_per_mm=90), InputError, "megapixels at 90 px/mm, but the limit is 16"),
    ],
)
def test_what_cannot_be_merged_is_refused(merging: Merging, wanted: MergeRequest, error: Any, message: str) -> None:
    with pytest.raises(error, match=message):
        merging.access.pictures("r1", wanted)


def test_flat_fields_of_another_array_are_refused(tmp_path: Path) -> None:
    fields = measure_flat_fields(film(tmp_path / "white", white(120)))
    write_flat_fields(tmp_path, fields)
    with pytest.raises(InputError, match="are of an array of 2 cameras, but 3 cameras were filming"):
        make(tmp_path).access.image("r1", MergeRequest("U1"), None, "npy")
