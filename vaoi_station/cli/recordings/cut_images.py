"""The options by which `vaoi cut` chooses temporary images, and the files that it writes for a component."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from vaoi_station.library.recordings import StitchedRun
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
    from vaoi_station.rendering.description import component_covariances, describe

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
