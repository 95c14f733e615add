"""The commands that calibrate: calibrate, calibration-board, recalibrate, flatfield."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vaoi_station.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vaoi_station.calibration import CameraResult, Limits, Outcome
    from vaoi_station.drift.checks import RunCheck
    from vaoi_station.model import Calibration, CameraHead, RecordingHead


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
    from vaoi_station.files.calibrations import read_layout
    from vaoi_station.files.images import write_image

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
    from vaoi_station.files.calibrations import write_layout
    from vaoi_station.files.documents import write_bytes

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


def recalibrate(
    cases: Annotated[list[Path] | None, typer.Argument(help="Recordings of boards (directories).")] = None,
    *,
    out: Annotated[Path, typer.Option(help="Write the proposed calibration to this new file.")],
    config: Annotated[
        Path | None,
        typer.Option(help="Use the runs that the station of this station.toml has filmed, instead of recordings."),
    ] = None,
    runs: Annotated[
        int | None,
        typer.Option(min=1, help="Use this number of the latest runs [all since a camera moved, at most 50]."),
    ] = None,
) -> None:
    """Propose corrected camera matrices N_i from runs of boards. The calibration in use is not changed."""
    if bool(cases) == (config is not None):
        raise InputError("recalibrate needs either recordings or --config.", action="Give exactly one of them.")
    # Checked before the computation. A calibration in use must never be replaced unnoticed.
    from vaoi_station.files.directories import refuse_existing

    refuse_existing(out, action="Choose another --out; put the proposal into use by hand.")
    from vaoi_station.drift.recalibrate import recalibrate as propose
    from vaoi_station.files import write_calibration

    calibration, heads, checks = _recorded(cases) if cases else _stored(config or Path())
    used = _chosen(checks, runs)
    proposal = propose(calibration, heads, used)
    typer.echo(f"{len(used)} runs, {used[0].run} to {used[-1].run}")
    for line in proposal.lines():
        typer.echo(line)
    if not proposal.corrected:
        typer.echo("no camera has moved; the calibration remains valid, and nothing is written")
        return
    write_calibration(out, proposal.calibration)
    _show(calibration, proposal.calibration, heads, out)


def _chosen(checks: Sequence[RunCheck], runs: int | None) -> Sequence[RunCheck]:
    """Return the checks of the latest `runs` runs; if `runs` is None, of all runs since a camera last moved."""
    from vaoi_station.drift.recalibrate import MOST_RUNS
    from vaoi_station.drift.watch import find_drifts

    if runs is not None:
        return checks[-runs:]
    # Runs from before a displacement would average the old and the new position of the camera.
    since = max((drift.since for drift in find_drifts(checks)), default=0)
    return checks[since:][-MOST_RUNS:]


def _recorded(cases: Sequence[Path]) -> tuple[Calibration, tuple[CameraHead, ...], list[RunCheck]]:
    from vaoi_station.drift.check_run import check_recording
    from vaoi_station.stitching.recordings.opening import open_run

    opened = [open_run(case) for case in cases]
    first = opened[0]
    # Calibrations are compared by value, because every recording holds a copy of the file.
    in_use = first.calibration.model_dump_json()
    for other, case in zip(opened, cases, strict=True):
        if other.calibration.model_dump_json() != in_use:
            raise InputError(
                f"{case / 'calibration.json'}: differs from {first.calibration_path}.",
                action="Give runs that were filmed with one calibration.",
            )
    return first.calibration, first.recording.head.cameras, [check_recording(o) for o in opened]


def _stored(config: Path) -> tuple[Calibration, tuple[CameraHead, ...], list[RunCheck]]:
    from vaoi_station.config import read_config
    from vaoi_station.drift.checks import RunCheck
    from vaoi_station.files import read_calibration
    from vaoi_station.runs.control.calibration_watch import FIRST_CHECKS, LATEST_CHECKS
    from vaoi_station.station import DATABASE
    from vaoi_station.store import Database, Store
    from vaoi_station.store.documents import digest_of

    station = read_config(config)
    calibration = read_calibration(station.calibration, [c.head for c in station.cameras])
    path = station.data / DATABASE
    if not path.is_file():
        raise InputError(f"{path}: does not exist; this station has filmed no board.", action="Film boards first.")
    store = Store(Database(path))
    try:
        kept = store.checks.documents(digest_of(calibration.model_dump_json()), FIRST_CHECKS, LATEST_CHECKS)
    finally:
        store.close()
    if not kept:
        raise InputError(
            f"{path}: has no run with the calibration {station.calibration}.",
            action="Film boards with this calibration, or give recordings.",
            code="too-little-evidence",
        )
    return calibration, tuple(c.head for c in station.cameras), [RunCheck.model_validate_json(text) for text in kept]


def _show(before: Calibration, after: Calibration, heads: Sequence[CameraHead], out: Path) -> None:
    from vaoi_station.calibration.calibration_difference import compare_calibrations
    from vaoi_station.calibration.pictures.difference_picture import draw_difference
    from vaoi_station.files.images import write_image

    difference = compare_calibrations(before, after, heads, one_board=True)
    for line in difference.lines():
        typer.echo(line)
    picture = out.with_name(f"{out.stem}-difference.png")
    write_image(picture, draw_difference(difference, heads))
    typer.echo(f"→ {out}, picture {picture}")


def _colours(white: tuple[float, float, float] | None, balanced: bool) -> str:
    if white is None:
        return ""
    why = "" if balanced else " (no white light: colours are not balanced)"
    return f", red : green : blue {' : '.join(f'{share:.2f}' for share in white)}{why}"


def flatfield(
    white: Annotated[Path, typer.Argument(help="Recording of a white target that fills all frames (a directory).")],
    out: Annotated[Path, typer.Option(help="Write the flat fields to this new directory.")],
    dark: Annotated[
        Path | None, typer.Option(help="Recording of darkness, with the lamps off [a dark level of 0 is assumed].")
    ] = None,
) -> None:
    """Measure one flat field per camera and light, for linear radiance."""
    from vaoi_station.files import open_recording
    from vaoi_station.files.directories import new_directory, refuse_existing
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
            f"{head.rows} rows{_colours(head.white, (head.camera, head.light) in fields.white_balances)}"
        )
    if dark is None:
        typer.echo("no darkness was given: a dark level of 0 is assumed, which makes dark places too bright")
    typer.echo(f"{len(document.fields)} flat fields → {out}")
