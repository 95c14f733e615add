"""`vaoi cut CASE --result result.json --component U1 --out DIR`: write the temporary images of components."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from vaoi_station.cli.recordings import cut_images as options

if TYPE_CHECKING:
    from vaoi_station.model import BoardType, Component


def cut(
    case: Annotated[Path, typer.Argument(help="Recording (a directory).")],
    result: Annotated[Path, typer.Option(help="Read the result of `vaoi stitch` from this file.")],
    out: Annotated[Path, typer.Option(help="Write the images to this directory.")],
    component: Annotated[
        list[str] | None,
        typer.Option(help="Cut this component (reference designator); repeat the option for several."),
    ] = None,
    all_components: Annotated[bool, typer.Option("--all", help="Cut all components.")] = False,
    region: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="X0 Y0 X1 Y1", help="With --hdr: a part of the board, in CAD coordinates."),
    ] = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration [CASE/calibration.json].")] = None,
    board: Annotated[Path | None, typer.Option(help="Use this board type [CASE/board.json].")] = None,
    heights: Annotated[
        Path | None, typer.Option(help="Take the heights of bodies from this file (of `vaoi heights`).")
    ] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="Resolution of the images [that of the cameras].")
    ] = None,
    min_coverage: Annotated[
        float | None,
        typer.Option(min=0, max=1, help="Skip frames that show a smaller share of it [0.5; with --hdr 0.02]."),
    ] = None,
    hdr: Annotated[bool, typer.Option("--hdr", help="Merge frames of several exposures to linear radiance.")] = False,
    flatfield: Annotated[
        Path | None, typer.Option(help="With --hdr: use these flat fields (of `vaoi flatfield`).")
    ] = None,
    format: Annotated[
        Literal["npy", "tiff", "png", "jpeg"] | None,
        typer.Option(help="With --hdr: linear radiance (npy, tiff) or tone-mapped 8 bit (png, jpeg) [tiff]."),
    ] = None,
    sigma: Annotated[
        bool, typer.Option("--sigma", help="With --hdr: also write the standard deviation of every pixel.")
    ] = False,
    margin_mm: options.Margin = 0.0,
    align: options.Align = "cad",
    plane: options.Plane = "board",
    light: options.Light = None,
    minus: options.Minus = None,
    seen_from: options.SeenFrom = None,
    within_deg: options.Within = None,
    exposure_us: options.Exposures = None,
    angle_deg: options.Angles = None,
    min_sharpness: options.MinSharpness = None,
    max_saturated: options.MaxSaturated = None,
    order: options.Order = "best",
    limit: options.Limit = None,
) -> None:
    """Cut upright, CAD-aligned images of components from all or chosen frames, or merge their exposures."""
    from vaoi_station.cli.recordings.cut_hdr import Case, cut_merged
    from vaoi_station.errors import InputError
    from vaoi_station.library.recordings import StitchedRun

    chosen = [bool(component), all_components, region is not None]
    if sum(chosen) != 1:
        raise InputError(
            f"vaoi cut: {sum(chosen)} of --component, --all and --region were given, but it must be one.",
            action="Name components, or all of them, or a region.",
        )
    only_merged = {"--region": region, "--flatfield": flatfield, "--format": format, "--sigma": sigma or None}
    for name, value in only_merged.items():
        if value is not None and not hdr:
            raise InputError(f"vaoi cut: {name} was given without --hdr.", action=f"Add --hdr, or leave {name} out.")
    wanted = options.image_request(
        exposure_us, angle_deg, seen_from, px_per_mm=px_per_mm, margin_mm=margin_mm, align=align, plane=plane,
        min_coverage=0.5 if min_coverage is None else min_coverage, min_sharpness_per_mm=min_sharpness,
        max_saturated=max_saturated, light=light, minus=minus, within_deg=within_deg, order=order, limit=limit,
    )  # fmt: skip
    if hdr:
        options.refuse_with_hdr(wanted)
    opened = Case.open(case, result, calibration, board, heights)
    parts = opened.board_type.components if all_components else _named(opened.board_type, component or ())
    if hdr:
        cut_merged(
            opened, parts, out, region=region, light=light, px_per_mm=px_per_mm, min_coverage=min_coverage,
            flatfield=flatfield, form=(format or "tiff", sigma),
        )  # fmt: skip
        return
    run = StitchedRun(opened.recording, tuple(opened.cameras), opened.board_type, opened.stitch)
    for part in parts:
        options.write_images(run, part.address, wanted, out)


def _named(board_type: BoardType, addresses: Sequence[str]) -> Iterator[Component]:
    """Yield the components with these addresses; raise NotFoundError for one that the board type does not have."""
    from vaoi_station.errors import NotFoundError

    for address in addresses:
        part = board_type.component(address)
        if part is None:
            raise NotFoundError(
                f"board type {board_type.name!r} has no component {address!r}.",
                action=f"It has {', '.join(c.address for c in board_type.components[:8])} …",
            )
        yield part
