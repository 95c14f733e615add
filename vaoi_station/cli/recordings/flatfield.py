"""`vaoi flatfield WHITE --dark DARK --out DIR`: measure flat fields, dark level and noise of the cameras."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def flatfield(
    white: Annotated[Path, typer.Argument(help="Recording of a white target that fills all frames (a directory).")],
    out: Annotated[Path, typer.Option(help="Write the flat fields to this new directory.")],
    dark: Annotated[
        Path | None, typer.Option(help="Recording of darkness, with the lamps off [a dark level of 0 is assumed].")
    ] = None,
) -> None:
    """Measure one flat field per camera and light, for linear radiance."""
    from vaoi_station.files import open_recording
    from vaoi_station.files.atomic_directory import new_directory, refuse_existing
    from vaoi_station.photometry.flat_fields import write_flat_fields
    from vaoi_station.photometry.measurement import measure_flat_fields

    refuse_existing(out)
    fields = measure_flat_fields(open_recording(white), None if dark is None else open_recording(dark))
    with new_directory(out) as draft:
        write_flat_fields(draft, fields)
    document = fields.document
    assert document is not None, "measured fields have a document"
    for i, camera in enumerate(document.cameras):
        pixels = ", differs from pixel to pixel" if camera.dark_file else ""
        typer.echo(
            f"camera {i}: dark level {camera.dark:.2f}{pixels}, read noise {camera.read:.2f} grey levels, "
            f"shot noise {camera.shot:.4f} per grey level"
        )
    for head in document.fields:
        flat = fields.flats[head.camera, head.light]
        light = "" if head.light is None else f" under {head.light!r}"
        typer.echo(
            f"camera {head.camera}{light}: {head.level:.4g} grey levels/µs, flat {flat.min():.3f} to {flat.max():.3f}, "
            f"{head.rows} rows"
        )
    if dark is None:
        typer.echo("no darkness was given: a dark level of 0 is assumed, which makes dark places too bright")
    typer.echo(f"{len(document.fields)} flat fields → {out}")
