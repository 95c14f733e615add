"""`vaoi cut --hdr`: merge the frames of several exposures that show a component or a region."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import typer
from numpy.typing import NDArray

from vaoi_station.cli.opened_case import Case
from vaoi_station.errors import InputError
from vaoi_station.files import Recording
from vaoi_station.files.documents import write_bytes, write_json
from vaoi_station.hdr import Exposed, MergedPicture, merge_views
from vaoi_station.hdr.encoding import LINEAR, MergedFormat, ToneCurve, encode_merged
from vaoi_station.hdr.merging import bodies_in, merge_region, region_component, views_of_bodies, views_on_top
from vaoi_station.hdr.row_levels import at_level, row_levels
from vaoi_station.model import Component, RecordingHead
from vaoi_station.model.recording import usual_light
from vaoi_station.model.stitch_result import known_height_mm
from vaoi_station.photometry import FlatFields, NoiseModel, Taken, noise_from_frames
from vaoi_station.rendering import View, ViewCalculator

_NOISE_FRAMES = 4
"""Number of frames from which the noise is estimated without flat fields."""


def cut_merged(
    case: Case,
    parts: Iterable[Component],
    out: Path,
    *,
    region: tuple[float, float, float, float] | None,
    light: str | None,
    px_per_mm: float | None,
    min_coverage: float | None,
    flatfield: Path | None,
    form: tuple[MergedFormat, bool],
) -> None:
    """Write the merged pictures of components, or of a region, and a listing of each.

    Frames under one light are merged: `light`, by default that of most frames. `form` is the format of the pictures,
    and whether their standard deviation is written as well.
    """
    if region is not None:
        parts = [region_component(region, case.board_type, px_per_mm or case.px_per_mm)]
    if form[1] and form[0] not in LINEAR:
        raise InputError(
            f"vaoi cut: --sigma was given with --format {form[0]}, but only npy and tiff hold a standard deviation.",
            action="Use --format npy or tiff.",
        )
    head = case.recording.head
    fields = FlatFields.open(flatfield) if flatfield else FlatFields.none(_noise(case.recording))

    def pixels(camera: int, row: int) -> NDArray[Any]:
        found = case.frame(camera, row)
        assert found is not None, "views of missing frames are left out"
        return found

    taken = _taken(head, light)

    def all_exposed(views: Iterable[View]) -> list[Exposed]:
        return [
            Exposed(
                v,
                at_level(taken[v.camera, v.row], levels[v.row]),
                fields.maps(v.camera, head.light(v.row)),
                (head.cameras[v.camera].width, head.cameras[v.camera].height),
                partial(pixels, v.camera, v.row),
            )
            for v in views
            if (v.camera, v.row) in taken
        ]

    shown = next((of.light for of in taken.values()), None)
    fields.check(head.cameras, None if shown is None else (shown,))
    levels = row_levels(taken, case.board_type, case.stitch, case.cameras, fields, case.frame)
    calculator = ViewCalculator(case.board_type, case.stitch, case.cameras)
    for part in parts:
        height = known_height_mm(part, case.board_type, case.stitch)
        views = views_on_top(calculator, part, height, px_per_mm=px_per_mm, min_coverage=min_coverage)
        exposed = all_exposed(views)
        if region is None or not exposed:
            pictures = merge_views(exposed, sigma=form[1]) if exposed else []
        else:
            bodies = bodies_in(exposed[0].view, case.board_type, case.stitch)
            seen = views_of_bodies(calculator, bodies, exposed[0].view.px_per_mm)
            pictures = merge_region(exposed, [(body, all_exposed(of)) for body, of in seen], sigma=form[1])
        same = {"plane_height_mm": round(height, 4)} | ({} if shown is None else {"light": shown})
        _write(part, pictures, out, form, same)


def _taken(head: RecordingHead, light: str | None) -> dict[tuple[int, int], Taken]:
    """Return what the frames (camera, row) of one light were taken with: metal differs under each."""
    every = {
        (i, j): Taken(head.exposure_us(i, j), head.gain(i, j), head.light(j) or None)
        for i in range(len(head.cameras))
        for j in range(head.rows)
        if (i, j) not in head.missing
    }
    lights = [of.light for of in every.values()]
    if light is not None and light not in lights:
        names = ", ".join(repr(name) for name in dict.fromkeys(lights) if name is not None) or "none that is named"
        raise InputError.field("vaoi cut", "light", light, f"one of the lights of the run: {names}")
    wanted = usual_light(lights) if light is None else light
    return {key: of for key, of in every.items() if of.light == wanted}


def _write(
    part: Component,
    pictures: Sequence[MergedPicture],
    out: Path,
    form: tuple[MergedFormat, bool],
    same: dict[str, Any],
) -> None:
    stem = part.address.replace("/", "_")
    curve = ToneCurve.of(pictures[-1].value) if pictures else None
    suffix = {"jpeg": "jpg"}.get(form[0], form[0])
    listing = []
    for k, picture in enumerate(pictures):
        name = f"{stem}_hdr.{suffix}" if k == len(pictures) - 1 else f"{stem}_hdr_{k:02d}.{suffix}"
        write_bytes(out / name, encode_merged(picture.value, form[0], curve), durable=False)
        entry: dict[str, Any] = {"file": name, **_describe(picture), **same}
        if form[1]:
            entry["sigma_file"] = name.replace("_hdr", "_hdr_sigma", 1)
            write_bytes(out / entry["sigma_file"], encode_merged(picture.sigma, form[0]), durable=False)
        listing.append(entry)
    write_json(out / f"{stem}.json", listing)
    if not pictures:
        typer.echo(f"{part.address}: no frame shows it; no picture was written")
        return
    last = pictures[-1]
    under = f" under the light {same['light']!r}" if "light" in same else ""
    note = "" if last.exposures > 1 else "; only one exposure shows it, so bright places may have no value"
    typer.echo(
        f"{part.address}: {len(pictures)} merged picture(s) of {len(last.views)} frames{under} and {last.exposures} "
        f"exposure(s), {last.holes:.2%} without a value{note} → {out}"
    )


def _describe(picture: MergedPicture) -> dict[str, Any]:
    return {
        **describe_view(picture.views[0]),
        "merged": [[v.camera, v.row] for v in picture.views],
        "exposures": picture.exposures,
        "holes": round(picture.holes, 6),
    }


def describe_view(view: View) -> dict[str, Any]:
    """Return frame, coverage, resolution and matrices of a view, as the listings of `vaoi cut` have them."""
    return {
        "camera": view.camera,
        "row": view.row,
        "coverage": round(view.coverage, 4),
        "px_per_mm": view.px_per_mm,
        "crop_from_cad": view.crop_from_cad.matrix.tolist(),
        "cad_from_crop": view.cad_from_crop.matrix.tolist(),
        "image_from_crop": view.image_from_crop.matrix.tolist(),
        "image_from_crop_is": "undistorted pixels" if view.distorted else "raw pixels",
    }


def _noise(recording: Recording) -> NoiseModel:
    head = recording.head
    keys = [(i, j) for j in range(head.rows) for i in range(len(head.cameras)) if (i, j) not in head.missing]
    keys.sort(key=lambda k: head.exposure_us(*k) * head.gain(*k))
    chosen = (
        {keys[int(n)] for n in np.linspace(0, len(keys) - 1, min(len(keys), _NOISE_FRAMES)).round()} if keys else ()
    )
    found = (recording.frame(*key) for key in chosen)
    return noise_from_frames(frame for frame in found if frame is not None)
