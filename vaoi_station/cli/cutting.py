"""`vaoi cut CASE --result result.json --component U1 --out DIR`: write the temporary images of components."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from vaoi_station.cli.options import BoardOf, CalibrationOf, CaseOf, ResultOf

if TYPE_CHECKING:
    from vaoi_station.library.recordings import StitchedRun
    from vaoi_station.model import BoardType, Component
    from vaoi_station.rendering import ImageRequest

Margin = Annotated[float, typer.Option(help="Show this much around the component, mm.")]
Align = Annotated[Literal["cad", "part"], typer.Option(help="Upright as CAD, or as the component at rotation 0.")]
Plane = Annotated[Literal["board", "top"], typer.Option(help="Plane of the images: the board, or the body's top.")]
Light = Annotated[
    str | None, typer.Option(help="Only images under this light; with --hdr by default that of most frames.")
]
Minus = Annotated[str | None, typer.Option(help="Subtract the image under this light, seen from the same side.")]
SeenFrom = Annotated[
    str | None,
    typer.Option(help="Only images from this side of the image (left, right, front, back) or azimuth in CAD, degrees."),
]
Within = Annotated[
    float | None, typer.Option(help="With --seen-from: largest difference from it, degrees.", show_default="45")
]
Exposures = Annotated[
    tuple[float, float] | None, typer.Option(metavar="MIN MAX", help="Only images with such an exposure time, µs.")
]
Angles = Annotated[
    tuple[float, float] | None,
    typer.Option(metavar="MIN MAX", help="Only images seen under such an angle from the vertical, degrees."),
]
MinSharpness = Annotated[float | None, typer.Option(help="Least sharpness, 1/mm.")]
MaxSaturated = Annotated[float | None, typer.Option(help="Largest share of saturated pixels.")]
Order = Annotated[Literal["best", "sharpest"], typer.Option(help="What comes first.")]
Limit = Annotated[int | None, typer.Option(help="Largest number of images of a component.")]


def image_request(
    exposure_us: tuple[float, float] | None, angle_deg: tuple[float, float] | None, seen_from: str | None, **given: Any
) -> ImageRequest:
    """Make a request from the options of the command. Raise InputError if one is outside its limits."""
    from vaoi_station.rendering import ImageOptions, ImageRequest
    from vaoi_station.rendering.request import direction

    options = ImageOptions(seen_from=direction(seen_from), measure=True, **given)  # type: ignore[typeddict-item]
    if exposure_us is not None:
        options["min_exposure_us"], options["max_exposure_us"] = exposure_us
    if angle_deg is not None:
        options["min_angle_deg"], options["max_angle_deg"] = angle_deg
    return ImageRequest.of(options)


def refuse_with_hdr(wanted: ImageRequest) -> None:
    """Raise InputError if a request chooses images by more than --hdr knows: light, resolution and coverage."""
    from vaoi_station.errors import InputError

    chosen = set(wanted.options()) - {"light", "px_per_mm", "min_coverage", "measure"}
    if chosen:
        raise InputError(
            f"vaoi cut: --hdr merges all frames of a component under one light, so {', '.join(sorted(chosen))} cannot "
            "be chosen with it.",
            action="Leave out --hdr, or these options.",
        )


def write_images(run: StitchedRun, address: str, wanted: ImageRequest, out: Path) -> None:
    """Write the images of a component that a request asks for, and their list; state how many there are."""
    from vaoi_station.files.documents import write_json
    from vaoi_station.files.images import write_image
    from vaoi_station.rendering.selection import component_covariances, describe

    chosen, covariances = run.choose(address, wanted), component_covariances(run.result, address)
    # On a panel the address is panel/ref. In a file name the slash would create a directory.
    stem, listing = address.replace("/", "_"), []
    for k, choice in enumerate(chosen.chosen):
        camera, row = choice.view.camera, choice.view.row
        name = f"{stem}_{k:02d}_c{camera:02d}_r{row:03d}.png"
        write_image(out / name, run.load(choice))
        known = describe(choice, chosen.covariance_px2(choice, covariances.get((camera, row))))
        pixels = "undistorted pixels" if choice.view.distorted else "raw pixels"
        # Figures that are not known are left out, as in replies of the station.
        listing.append(
            {"file": name, **{k: v for k, v in known.items() if v is not None}, "image_from_crop_is": pixels}
        )
    write_json(out / f"{stem}.json", listing)
    typer.echo(f"{address}: {len(listing)} image(s) → {out}")
    if chosen.remark:
        typer.echo(f"{address}: {chosen.remark}")


def cut(
    case: CaseOf,
    result: ResultOf,
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
    calibration: CalibrationOf = None,
    board: BoardOf = None,
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
        Path | None,
        typer.Option(help="Use these flat fields (of `vaoi flatfield`): for radiance with --hdr, else for colours."),
    ] = None,
    format: Annotated[
        Literal["npy", "tiff", "png", "jpeg"] | None,
        typer.Option(help="With --hdr: linear radiance (npy, tiff) or tone-mapped 8 bit (png, jpeg) [tiff]."),
    ] = None,
    sigma: Annotated[
        bool, typer.Option("--sigma", help="With --hdr: also write the standard deviation of every pixel.")
    ] = False,
    margin_mm: Margin = 0.0,
    align: Align = "cad",
    plane: Plane = "board",
    light: Light = None,
    minus: Minus = None,
    seen_from: SeenFrom = None,
    within_deg: Within = None,
    exposure_us: Exposures = None,
    angle_deg: Angles = None,
    min_sharpness: MinSharpness = None,
    max_saturated: MaxSaturated = None,
    order: Order = "best",
    limit: Limit = None,
) -> None:
    """Cut upright, CAD-aligned images of components from all or chosen frames, or merge their exposures."""
    from vaoi_station.cli.cutting_merged import cut_merged
    from vaoi_station.cli.opened_case import Case
    from vaoi_station.errors import InputError
    from vaoi_station.library.recordings import StitchedRun
    from vaoi_station.photometry import FlatFields

    chosen = [bool(component), all_components, region is not None]
    if sum(chosen) != 1:
        raise InputError(
            f"vaoi cut: {sum(chosen)} of --component, --all and --region were given, but it must be one.",
            action="Name components, or all of them, or a region.",
        )
    only_merged = {"--region": region, "--format": format, "--sigma": sigma or None}
    for name, value in only_merged.items():
        if value is not None and not hdr:
            raise InputError(f"vaoi cut: {name} was given without --hdr.", action=f"Add --hdr, or leave {name} out.")
    wanted = image_request(
        exposure_us, angle_deg, seen_from, px_per_mm=px_per_mm, margin_mm=margin_mm, align=align, plane=plane,
        min_coverage=0.5 if min_coverage is None else min_coverage, min_sharpness_per_mm=min_sharpness,
        max_saturated=max_saturated, light=light, minus=minus, within_deg=within_deg, order=order, limit=limit,
    )  # fmt: skip
    if hdr:
        refuse_with_hdr(wanted)
    opened = Case.open(case, result, calibration, board, heights)
    parts = opened.board_type.components if all_components else _named(opened.board_type, component or ())
    if hdr:
        cut_merged(
            opened, parts, out, region=region, light=light, px_per_mm=px_per_mm, min_coverage=min_coverage,
            flatfield=flatfield, form=(format or "tiff", sigma),
        )  # fmt: skip
        return
    fields = FlatFields.peek(flatfield) if flatfield else FlatFields.none()
    fields.check_head(opened.recording.head)
    run = StitchedRun(opened.recording, tuple(opened.cameras), opened.board_type, opened.stitch, fields)
    for part in parts:
        write_images(run, part.address, wanted, out)


def _named(board_type: BoardType, addresses: Sequence[str]) -> Iterator[Component]:
    from vaoi_station.errors import NotFoundError

    for address in addresses:
        part = board_type.component(address)
        if part is None:
            raise NotFoundError(
                f"board type {board_type.name!r} has no component {address!r}.",
                action=f"It has {', '.join(c.address for c in board_type.components[:8])} …",
            )
        yield part
