"""`vaoi calibrate CASE --out calibration.json`: estimate camera matrices from a recording of the calibration board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vaoi_station.errors import InputError

if TYPE_CHECKING:
    from vaoi_station.calibration import CameraResult, Limits, Outcome
    from vaoi_station.model import Calibration, RecordingHead


def calibrate(
    case: Annotated[Path, typer.Argument(help="Recording of the calibration board (a directory).")],
    *,
    out: Annotated[Path | None, typer.Option(help="Write the calibration to this file.")] = None,
    layout: Annotated[
        Path | None, typer.Option(help="Read the marks of the board from this file [CASE/layout.json].")
    ] = None,
    row: Annotated[int | None, typer.Option(min=0, help="Use this row of a recording of several rows.")] = None,
    working_distance_mm: Annotated[
        float | None, typer.Option(min=1, max=1e5, help="Distance of the cameras from the surface of the board.")
    ] = None,
    residual_limit_px: Annotated[
        float, typer.Option(min=0.001, max=100, help="Refuse a camera whose residuals are larger (rms).")
    ] = 0.2,
    center_tolerance_mm: Annotated[
        float,
        typer.Option(min=0.01, max=100, help="How well nominal_center_mm is known for the board as it lies (2 σ)."),
    ] = 2.0,
    mark_accuracy_um: Annotated[
        float, typer.Option(min=0, max=1000, help="Accuracy of the marks' positions on the board (1 σ per axis).")
    ] = 0.0,
    flatness_um: Annotated[
        float, typer.Option(min=0, max=5000, help="Deviation of the board from a plane within one view (1 σ).")
    ] = 0.0,
    report: Annotated[Path | None, typer.Option(help="Write the pictures to this directory [that of --out].")] = None,
    compare: Annotated[
        Path | None, typer.Option(help="Compare with this calibration of the same array, in px.")
    ] = None,
    existing: Annotated[
        Path | None, typer.Option(help="Do not calibrate; compare this calibration (with --compare).")
    ] = None,
) -> None:
    """Calibrate the camera array: estimate N_i and lenses from marks. Refuse bad fits with a picture."""
    from vaoi_station.files import open_recording, read_calibration

    recording = open_recording(case)
    head = recording.head
    other = None if compare is None else read_calibration(compare, head.cameras)
    if existing is not None:
        if other is None or out is not None:
            raise InputError(
                "--existing is given without --compare, or with --out.", action="Give --compare with it, and no --out."
            )
        _compare(read_calibration(existing, head.cameras), other, head, report, f"{existing.stem}")
        return
    if out is None:
        raise InputError("--out is missing.", action="Give the file to which the calibration is written.")
    from vaoi_station.calibration import Limits

    if flatness_um and working_distance_mm is None:
        raise InputError(
            "--flatness-um is given without --working-distance-mm, which says how far a height moves the picture.",
            action="Give the distance of the cameras from the board.",
        )
    limits = Limits(
        residual_limit_px, working_distance_mm, center_tolerance_mm, mark_accuracy_um / 1000, flatness_um / 1000
    )
    made = _calibrate(case, out, layout, row, limits, report or out.parent)
    if other is not None:
        _compare(made, other, head, report or out.parent, out.stem)


def _calibrate(
    case: Path,
    out: Path,
    layout: Path | None,
    row: int | None,
    limits: Limits,
    report: Path,
) -> Calibration:
    from vaoi_station.calibration import calibrate as calibrate_array
    from vaoi_station.calibration.pictures.calibration_picture import draw_calibration
    from vaoi_station.files import open_recording, write_calibration
    from vaoi_station.files.images import write_image
    from vaoi_station.files.layouts import read_layout

    # A calibration needs exactly one row: the board must lie still in all frames that are used together.
    recording = open_recording(case)
    rows = recording.head.rows
    if row is None and rows != 1:
        raise InputError.field(case / "recording.json", "rows", rows, "1", "Choose one row with --row.")
    if row is not None and row >= rows:
        raise InputError.field("--row", "row", row, f"below the recording's {rows} rows")
    marks = read_layout(layout or case / "layout.json")
    outcome = calibrate_array(recording.head.cameras, lambda i: recording.frame(i, row or 0), marks, limits)
    picture = report / f"{out.stem}-report.png"
    # The picture is written before a refusal too: it shows why the camera was refused.
    write_image(picture, draw_calibration(outcome))
    if outcome.refused:
        error = outcome.error()
        raise InputError(error.message, action=f"{error.action} The picture is {picture}.", code=error.code)
    calibration = outcome.calibration()
    write_calibration(out, calibration)
    _print_fits(outcome, out, picture)
    return calibration


def _print_fits(outcome: Outcome, out: Path, picture: Path) -> None:
    for c in outcome.cameras:
        assert c.fit is not None
        typer.echo(
            f"camera {c.camera}: {c.used} of {len(c.marks)} marks, residuals {c.fit.rms_px:.4f} px rms, "
            f"standard deviation {c.corner_sigma_px:.3f} px at the frame corners, distortion there {_lens(c)}"
        )
    if not outcome.limits.mark_accuracy_mm:
        typer.echo(
            "- the marks are taken to be exactly where layout.json puts them: state their accuracy with "
            "--mark-accuracy-um"
        )
    for note in outcome.notes:
        typer.echo(f"- {note}")
    typer.echo(f"→ {out}, picture {picture}")


def _lens(camera: CameraResult) -> str:
    assert camera.fit is not None
    bent, sigma = camera.fit.lens_px
    return f"{bent:+.3f} ± {sigma:.3f} px" if camera.lens_known else f"not determined (± {sigma:.1f} px assumed)"


def _compare(this: Calibration, other: Calibration, head: RecordingHead, report: Path | None, stem: str) -> None:
    from vaoi_station.calibration.calibration_difference import compare_calibrations
    from vaoi_station.calibration.pictures.difference_picture import draw_difference
    from vaoi_station.files.images import write_image

    difference = compare_calibrations(this, other, head.cameras)
    for line in difference.lines():
        typer.echo(line)
    if report is not None:
        picture = report / f"{stem}-difference.png"
        write_image(picture, draw_difference(difference, head.cameras))
        typer.echo(f"→ {picture}")
