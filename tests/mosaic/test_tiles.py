"""Tiles: brightness and place of what they show, seams, what no frame shows, colour, 16 bits and HDR."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from tests.mosaic.conftest import BOARD_MM, DARK, SIZE, Film, Filmed, radiance
from tests.mosaic.test_plan import plan_of
from vaoi_station.errors import InputError
from vaoi_station.geometry import apply
from vaoi_station.mosaic import MosaicGrid
from vaoi_station.mosaic.plan import MosaicPlan, RaisedBody
from vaoi_station.mosaic.tile_specs import TileRenderer
from vaoi_station.mosaic.tiles import FrameCache, render_tile, write_mosaic
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.flat_fields import FlatFieldDocument


def picture_of(board: Filmed, *, hdr: bool = False, reduced: int = 1, box: Any = None) -> Any:
    plan = plan_of(board, hdr=hdr, fields=FlatFields.none(dark=DARK))
    grid = board.base.reduced(reduced)
    spec = TileRenderer(plan, board.projector, grid).spec(box or (0, 0, grid.width, grid.height))
    return render_tile(spec, board.read), grid


def expected(grid: MosaicGrid) -> Any:
    y, x = np.mgrid[: grid.height, : grid.width].astype(float)
    return radiance(apply(grid.cad_from_mosaic, np.stack([x, y], -1)))


@pytest.mark.parametrize("reduced", [1, 4])
def test_whole_board_has_no_step(film: Film, reduced: int) -> None:
    picture, grid = picture_of(film(), reduced=reduced)
    ratio = picture.astype(float) / expected(grid)
    n = 16 // reduced
    h, w = (k // n * n for k in ratio.shape)
    means = ratio[:h, :w].reshape(h // n, n, w // n, n).mean((1, 3))
    steps = np.concatenate([np.abs(np.diff(means, axis=k)).ravel() for k in (0, 1)])
    assert np.percentile(steps, 95) < 0.015 * reduced**0.5
    assert steps.max() < 0.05


@pytest.mark.parametrize(("reduced", "hdr", "most"), [(32, False, 0.25), (64, False, 0.5), (64, True, 0.5)])
def test_an_overview_has_no_hole_where_frames_end(film: Film, reduced: int, hdr: bool, most: float) -> None:
    """Cameras overlap by 70 px, and 32 or 64 px are a pixel of the overview; its texture has a period of 160 px."""
    board = film(exposures=(250.0, 150.0), step_mm=6.0) if hdr else film()
    picture, _ = picture_of(board, hdr=hdr, reduced=reduced)
    # The last pixels may overlap the end of the board.
    h, w = board.base.height // reduced, board.base.width // reduced
    means = expected(board.base)[: h * reduced, : w * reduced].reshape(h, reduced, w, reduced).mean((1, 3))
    ratio = picture[:h, :w] / means
    assert np.isfinite(ratio).all()
    assert np.abs(ratio / np.median(ratio) - 1).max() < most


def test_tiles_join_without_a_gap(board: Filmed) -> None:
    whole, _ = picture_of(board)
    part, _ = picture_of(board, box=(100, 130, 356, 386))
    assert np.abs(whole[130:386, 100:356].astype(int) - part).max() <= 2


@pytest.mark.parametrize(("dtype", "channels"), [(np.uint16, 1), (np.uint8, 3), (np.uint16, 3)])
def test_pixel_types_and_colour(film: Film, dtype: Any, channels: int) -> None:
    picture, grid = picture_of(film(dtype=dtype, channels=channels))
    assert picture.dtype == dtype
    grey = picture if channels == 1 else picture[..., 1]
    ratio = grey / (257.0 if dtype == np.uint16 else 1.0) / expected(grid)
    assert ratio.std() < 0.03
    assert ratio.mean() == pytest.approx(0.95, abs=0.08)


def test_a_tint_of_the_light_is_balanced_by_flat_fields_in_colour(film: Film) -> None:
    tinted = film(channels=3)
    tint = np.array([0.5, 1.0, 0.8])  # blue, green, red
    frames = {k: np.rint((p - DARK).clip(0) * tint + DARK).astype(np.uint8) for k, p in tinted.frames.items()}
    size = {"width": SIZE[0], "height": SIZE[1], "dark": DARK, "read": 1.0, "shot": 0.03}
    heads = [
        {"camera": c, "file": f"fields/{c}.tiff", "level": 1, "rows": 4, "white": (0.9, 1.12, 0.56)} for c in (0, 1)
    ]
    fields = FlatFields(
        FlatFieldDocument.model_validate(
            {"format": "vaoi-flatfield", "version": 1, "cameras": [size] * 2, "fields": heads}
        ),
        {(c, None): np.ones(SIZE[::-1], np.float32) for c in (0, 1)},
    )
    board = replace(tinted, frames=frames)
    plan = plan_of(board, fields=fields)
    spec = TileRenderer(plan, board.projector, board.base).spec((0, 0, board.base.width, board.base.height))
    picture = render_tile(spec, board.read)
    assert picture is not None
    red, blue = picture[..., 2].mean(), picture[..., 0].mean()
    assert [red, blue] == pytest.approx([picture[..., 1].mean()] * 2, rel=0.01)


@pytest.mark.parametrize(
    ("dtype", "channels", "names"),
    [(np.uint16, 1, "8 bits grey, 16 bits grey"), (np.uint8, 3, "8 bits grey, 8 bits in colour")],
)
def test_cameras_of_different_pixel_formats_are_refused(film: Film, dtype: Any, channels: int, names: str) -> None:
    board, other = film(), film(dtype=dtype, channels=channels)
    mixed = {key: (other.frames if key[0] else board.frames)[key] for key in board.frames}
    with pytest.raises(InputError, match="same pixel_format") as refusal:
        picture_of(replace(board, frames=mixed))
    assert f"have different pixel formats ({names})" in refusal.value.message


def test_hdr_is_radiance_where_the_long_exposure_saturates(film: Film) -> None:
    board = film(exposures=(480.0, 100.0), step_mm=6.0, flicker=0.0, vignette=0.0)
    assert max(int(p.max()) for p in board.frames.values()) == 255
    picture, grid = picture_of(board, hdr=True)
    assert picture.dtype == np.float32
    ratio = picture * 250 / expected(grid)
    assert np.isfinite(ratio).mean() > 0.95
    assert np.nanstd(ratio) < 0.03
    assert np.nanmedian(ratio) == pytest.approx(1.0, abs=0.05)


def bright_lines(cad: np.ndarray) -> Any:
    """Radiance of lines 3 px wide, 8 px apart, that saturate the long exposure only."""
    return np.where(cad[..., 0] % 0.8 < 0.3, 400.0, 50.0)


@pytest.mark.parametrize(("reduced", "short_us"), [(2, 60.0), (4, 60.0), (8, 60.0), (4, 240.0), (8, 240.0)])
def test_hdr_of_reduced_levels_has_no_saturated_detail(film: Film, reduced: int, short_us: float) -> None:
    """A block's mean is not saturated, although the long exposure saturates its lines; with 240 µs both do."""
    board = film(exposures=(480.0, short_us), step_mm=6.0, flicker=0.0, vignette=0.0, look=bright_lines)
    picture, _ = picture_of(board, hdr=True, reduced=reduced)
    h, w = board.base.height // reduced, board.base.width // reduced
    y, x = np.mgrid[: h * reduced, : w * reduced].astype(float)
    shown = bright_lines(apply(board.base.cad_from_mosaic, np.stack([x, y], -1)))
    middle = np.s_[h // 6 : -h // 6, w // 6 : -w // 6]
    found = (picture[:h, :w] * 250)[middle]
    truth = shown.reshape(h, reduced, w, reduced).mean((1, 3))[middle]
    assert np.isfinite(found).all()
    if short_us == 60.0:
        assert found.mean() == pytest.approx(truth.mean(), rel=0.02)
    else:
        # The shortest exposure is a lower bound, and nearer to the truth than the long one.
        assert 0.6 * truth.mean() < found.mean() < truth.mean()


def raised(board: Filmed, height_mm: float) -> Filmed:
    """Film the board anew, with the texture of the body U1 so far above it, by lamps and lenses without fault."""
    (u1, *others) = board.board_type.components
    solid = u1.model_copy(update={"body_height": height_mm})
    board_type = board.board_type.model_copy(update={"components": (solid, *others)})
    low, high = np.array(u1.center) - (u1.width / 2, u1.height / 2), np.array(u1.center) + (u1.width / 2, u1.height / 2)
    frames = {}
    for taken in board.taken:
        eye = board.cameras[taken.camera]
        v, u = np.mgrid[: eye.height_px, : eye.width_px].astype(float)
        cad_from_row = np.linalg.inv(board.stitch.row_motion[taken.row] @ np.asarray(board.stitch.cad_matrix))
        ground, top = (apply(cad_from_row, eye.ground(np.stack([u, v], -1), h)) for h in (0.0, height_mm))
        on_top = np.asarray(((top >= low) & (top <= high)).all(-1))
        light = radiance(np.where(on_top[..., None], top, ground)) * taken.exposure_us / 250
        frames[taken.camera, taken.row] = np.clip(np.round(DARK + light), 0, 255).astype(np.uint8)
    return replace(board, board_type=board_type, frames=frames)


@pytest.mark.parametrize("reduced", [1, 2])
def test_the_top_of_a_body_is_where_it_is_in_all_layers(film: Film, reduced: int) -> None:
    """The layers of HDR show a body from different frames, which see it at different places of the board's plane."""
    board = raised(film(exposures=(250.0, 150.0), step_mm=6.0), 12.0)
    plan = plan_of(board, hdr=True, fields=FlatFields.none(dark=DARK))
    grid = board.base.reduced(reduced)
    low, high = (apply(grid.mosaic_from_cad, np.array(at)).round().astype(int) for at in ((11.8, 11.8), (18.2, 16.2)))
    errors = []
    for shown in (replace(plan, bodies=()), plan):
        renderer = TileRenderer(shown, board.projector, grid)
        box = int(low[0]) - 20, int(low[1]) - 20, int(high[0]) - 5, int(high[1]) + 20
        picture = render_tile(renderer.spec(box), board.read)
        assert picture is not None
        ratio = picture * 250 / expected(grid)[box[1] : box[3], box[0] : box[2]]
        body = ratio[20:-20, 20:]
        errors.append(np.abs(body / np.median(ratio) - 1).max())
    assert errors[1] < 0.02 < errors[0] / 2


def test_an_overview_shows_a_low_body_with_the_ground(film: Film) -> None:
    """Its top is displaced by less than a tenth of a pixel."""
    board = raised(film(exposures=(250.0, 150.0), step_mm=6.0), 1.0)
    plan, grid = plan_of(board, hdr=True, fields=FlatFields.none(dark=DARK)), board.base.reduced(8)
    (x0, y0), (x1, y1) = (
        apply(grid.mosaic_from_cad, np.array(at)).round().astype(int) for at in ((11.5, 11.5), (18.5, 16.5))
    )
    spec = TileRenderer(plan, board.projector, grid).spec((0, 0, grid.width, grid.height))
    picture = render_tile(spec, board.read)
    assert picture is not None
    assert len(plan.bodies) == 1
    assert not spec.bodies
    ratio = picture * 250 / expected(grid)
    assert np.abs(ratio[y0:y1, x0:x1] / np.nanmedian(ratio) - 1).max() < 0.02


@pytest.mark.parametrize("factor", [1, 8])
def test_parts_hold_only_the_cells_of_their_frames(board: Filmed, factor: int) -> None:
    """All cells of a board in every part of its overview took 2 GB for 400 frames."""
    plan, grid = plan_of(board), board.base.reduced(factor)
    spec = TileRenderer(plan, board.projector, grid).spec((0, 0, grid.width, grid.height))
    numbers = {frame.taken[:2]: n for n, frame in enumerate(plan.frames)}
    found = np.full(plan.layers[0].shape, -1)
    for part in spec.parts:
        x0, y0, x1, y1 = part.cells
        assert part.mine is not None
        assert part.factor.shape == part.mine.shape == (y1 - y0, x1 - x0)
        found[y0:y1, x0:x1][part.mine > 0] = numbers[part.camera, part.row]
    np.testing.assert_array_equal(found, plan.layers[0])
    assert sum(part.factor.size for part in spec.parts) < 2 * found.size


def crowded(board: Filmed, height_mm: float) -> MosaicPlan:
    """Plan the board with 3,100 bodies of 0.6 × 0.3 mm; of each hundred the last is twice as high."""
    at = np.random.default_rng(1).uniform((1, 1), np.array(BOARD_MM) - 1, (3100, 2))
    box = np.array([(-0.3, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.3, 0.15)])
    bodies = [RaisedBody(box + p, height_mm * (2 if n % 100 == 99 else 1)) for n, p in enumerate(at)]
    return replace(plan_of(board, hdr=True), bodies=tuple(sorted(bodies, key=lambda body: body.height_mm)))


def test_an_overview_shows_only_bodies_that_their_heights_displace(board: Filmed) -> None:
    """The cameras are 300 mm above the board and see it up to 20 mm off their feet: 0.33 mm lean by 0.022 mm."""
    lean = board.projector.largest_lean(0)
    assert lean == pytest.approx(np.hypot(16, 12) / 300, rel=0.05)
    plan, base = crowded(board, 0.1 / lean / 10.0), board.base
    counts = {}
    for factor in (1, 2, 4, 8):
        grid = base.reduced(factor)
        box = (0, 0, min(grid.width, 256), min(grid.height, 256))
        spec = TileRenderer(plan, board.projector, grid).spec(box)
        counts[factor] = len(spec.bodies)
        assert len(spec.bodies) <= box[2] * box[3] / 256
    # At full resolution all are displaced enough, and the highest of the tile are taken; at half, the higher ones.
    assert counts == {1: 256, 2: 31, 4: 0, 8: 0}


def test_file_has_the_pixels_of_the_mosaic(board: Filmed, tmp_path: Path) -> None:
    layout = write_mosaic(tmp_path / "b.tif", plan_of(board), board.projector, board.base, board.read)
    with tifffile.TiffFile(tmp_path / "b.tif") as file:
        series = file.series[0]
        assert (len(series.levels), file.pages.first.is_tiled) == (layout.levels, True)
        assert series.levels[0].shape == (400, 520)
        assert (series.levels[0].asarray() > 0).all()
    assert [p.name for p in tmp_path.iterdir()] == ["b.tif"]


def test_frames_are_kept_up_to_a_number_of_bytes() -> None:
    read: list[tuple[int, int]] = []

    def frame(camera: int, row: int) -> np.ndarray:
        read.append((camera, row))
        return np.zeros(100, np.uint8)

    cache = FrameCache(frame, most_bytes=250)
    for key in [(0, 0), (0, 1), (0, 0), (0, 2), (0, 0), (0, 1)]:
        cache(*key)
    assert read == [(0, 0), (0, 1), (0, 2), (0, 1)]
