"""`vaoi calibration-board`: write the artwork of a calibration board for an array."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

import typer

from vaoi_station.errors import InputError

_DEFAULT_MARKS = "5x4"


def calibration_board(
    *,
    out: Annotated[Path, typer.Option(help="Write the artwork to this directory; it is created if necessary.")],
    config: Annotated[
        Path | None,
        typer.Option(help="Read number of cameras, frame sizes and nominal centres from this station.toml."),
    ] = None,
    cameras: Annotated[int | None, typer.Option(min=1, max=64, help="Number of cameras (n).")] = None,
    pitch_mm: Annotated[float | None, typer.Option(help="Distance between neighbouring cameras.")] = None,
    field_mm: Annotated[str | None, typer.Option(help="Field of view of one camera, as 34.8x26.")] = None,
    px_per_mm: Annotated[
        float | None, typer.Option(min=0.1, max=1000, help="With --config: resolution, which gives the field of view.")
    ] = None,
    marks_per_camera: Annotated[str, typer.Option(help="Marks per camera, columns x rows, as 5x4.")] = _DEFAULT_MARKS,
    mark_mm: Annotated[float, typer.Option(min=0.1, max=50, help="Size of a mark (a cross).")] = 2.0,
    tolerance_mm: Annotated[
        float, typer.Option(min=0, max=50, help="Distance of marks from the edge of a view.")
    ] = 3.0,
    light: Annotated[bool, typer.Option("--light", help="Make light marks on a dark board.")] = False,
) -> None:
    """Make a calibration board for an array: SVG, PDF (1:1, with a scale bar), Gerber files, and layout.json."""
    from vaoi_station.calibration.artwork import ArrayDesign, design_board
    from vaoi_station.calibration.artwork.artwork_files import RENDERERS, artwork_title
    from vaoi_station.files.documents import write_bytes
    from vaoi_station.files.layouts import write_layout

    count, pitch, field = _array(config, cameras, pitch_mm, field_mm, px_per_mm)
    across, down = _pair(marks_per_camera, "--marks-per-camera")
    design = ArrayDesign(
        count,
        pitch,
        field,
        columns=round(across),
        rows=round(down),
        mark_mm=mark_mm,
        tolerance_mm=tolerance_mm,
        polarity="light" if light else "dark",
    )
    board = design_board(design)
    w, h = board.size_mm
    title = artwork_title(board, pitch)
    for name, render in RENDERERS.items():
        write_bytes(out / name, render(board, title))
    write_layout(out / "layout.json", board.layout)
    typer.echo(f"{len(board.layout.marks)} marks for {count} cameras, board {w:g} × {h:g} mm → {out}")
    typer.echo("camera i: nominal_center_mm = [i × pitch, 0]; check the scale bar of the print with a ruler")


def _array(
    config: Path | None,
    cameras: int | None,
    pitch_mm: float | None,
    field_mm: str | None,
    px_per_mm: float | None,
) -> tuple[int, float, tuple[float, float]]:
    """Return number of cameras, distance of neighbours, and field of view, from the options or else from `config`."""
    view = None if field_mm is None else _pair(field_mm, "--field-mm")
    if config is not None:
        found = _configured(config, px_per_mm)
        cameras, pitch_mm, view = cameras or found[0], pitch_mm or found[1], view or found[2]
    # One camera has no neighbour; any distance gives the same artwork.
    if cameras == 1:
        pitch_mm = pitch_mm or 1.0
    given = {"--cameras": cameras, "--pitch-mm": pitch_mm, "--field-mm": view}
    missing = [name for name, value in given.items() if value is None]
    if cameras is None or pitch_mm is None or view is None:
        raise InputError(
            f"{', '.join(missing)} must be given.",
            action="Give them, or --config with a station whose cameras have nominal_center_mm and nominal_px_per_mm.",
        )
    return cameras, pitch_mm, view


def _configured(config: Path, px_per_mm: float | None) -> tuple[int, float | None, tuple[float, float] | None]:
    """Return number of cameras, distance of neighbours and field of view (mm) from nominal values in `config`."""
    from vaoi_station.calibration.artwork.artwork_files import array_of
    from vaoi_station.config import read_config

    heads = [camera.head for camera in read_config(config).cameras]
    return len(heads), *array_of(heads, px_per_mm)


def _pair(text: str, name: str) -> tuple[float, float]:
    match = re.fullmatch(r"\s*([0-9.]+)\s*[x×X*]\s*([0-9.]+)\s*", text)
    try:
        pair = (float(match[1]), float(match[2])) if match else None
    except ValueError:
        pair = None
    if pair is None or min(pair) <= 0:
        raise InputError.field(name, "value", text, "two numbers above 0, as 34.8x26")
    return pair
