"""Crops carry what is known about them, and show the component where their outline says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station import StitchedRun
from vaoi_station.errors import InputError, StateError
from vaoi_station.model import Component, Status
from vaoi_station.plant.archive import Archive
from vaoi_station.plant.datasets import Crop, CropOptions
from vaoi_station.plant.datasets.crops import crops_of
from vaoi_station.rendering import ImageOptions, ImageRequest


@pytest.fixture(scope="module")
def crops(boards: Archive, tmp_path_factory: pytest.TempPathFactory) -> list[Crop]:
    run = boards.run("r1")
    folder = boards.extract(run, tmp_path_factory.mktemp("crops") / "run")
    return list(crops_of(run, folder, CropOptions(("U*", "R1"))))


def test_crops_are_those_of_the_library(crops: list[Crop], stitched: StitchedRun) -> None:
    images = {(i.camera, i.row): i for i in stitched.component("U1")}
    mine = {(c.facts["camera"], c.facts["row"]): c for c in crops if c.facts["component"] == "U1"}
    assert set(mine) == set(images)
    for at, crop in mine.items():
        assert np.array_equal(crop.pixels, images[at].pixels)
        assert crop.facts["sigma_px"] == images[at].sigma_px
        assert crop.facts["exposure_us"] == images[at].exposure_us


def test_facts_name_run_board_and_component(crops: list[Crop]) -> None:
    facts = next(c.facts for c in crops if c.facts["component"] == "U1")
    assert (facts["station"], facts["run"], facts["board_id"], facts["verdict"]) == ("line 1", "r1", "B1", "ok")
    assert (facts["reference"], facts["package"], facts["side"], facts["light"]) == ("U1", "P U", "top", "ring")
    assert facts["body_height_mm"] > 0
    assert {c.facts["component"][0] for c in crops} == {"U", "R"}


def test_the_outline_is_counted_from_the_corner_of_the_crop(crops: list[Crop]) -> None:
    crop = next(c for c in crops if c.facts["component"] == "U1")
    assert crop.outline_px is not None
    height, width = crop.pixels.shape[:2]
    # Without a margin the crop is the box of the footprint, rounded up to whole pixels.
    assert crop.outline_px.min(0) == pytest.approx([0, 0], abs=1.01)
    assert crop.outline_px.max(0) == pytest.approx([width, height], abs=1.01)


def test_a_place_that_is_not_fitted_has_no_outline(crops: list[Crop]) -> None:
    empty = [c for c in crops if c.outline_px is None]
    assert empty
    assert {c.facts["component"] for c in empty} == {"R1"}


def test_the_verdict_is_that_of_the_run(boards: Archive, tmp_path: Path) -> None:
    """An identity that is required degrades a run whose result is ok."""
    run = boards.run("r1").model_copy(update={"verdict": Status.DEGRADED})
    crop = next(crops_of(run, boards.extract(run, tmp_path / "run"), CropOptions(("R1",))))
    assert crop.facts["verdict"] == "degraded"


def test_what_a_run_does_not_have_is_refused(boards: Archive, tmp_path: Path) -> None:
    run = boards.run("r1")
    folder = boards.extract(run, tmp_path / "run")
    dark = CropOptions(("U1",), ImageRequest.of(ImageOptions(light="infrared")))
    with pytest.raises(InputError, match="infrared"):
        list(crops_of(run, folder, dark))
    text = (folder / "result.json").read_text()
    (folder / "result.json").write_text(text.replace('"cad_matrix": [', '"cad_matrix": null, "x_old": [', 1))
    with pytest.raises(StateError, match="run r1: its result has no CAD mapping"):
        list(crops_of(run, folder, CropOptions()))


@pytest.mark.parametrize(
    ("wanted", "admitted"),
    [("X[1]", True), ("X[?]", True), ("X*", True), ("X1", False), ("2/X[1]", True), ("2/*", True)],
)
def test_brackets_belong_to_the_name(wanted: str, admitted: bool) -> None:
    part = Component(ref="X[1]", panel="2", center=(0.0, 0.0), width=1.0, height=1.0)
    assert CropOptions((wanted,)).admits(part) is admitted
