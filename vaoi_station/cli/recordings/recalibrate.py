"""`vaoi recalibrate`: propose corrected N_i from runs of boards."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from vaoi_station.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from vaoi_station.drift.checks import RunCheck
    from vaoi_station.model import Calibration, CameraHead


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
    from vaoi_station.files.atomic_directory import refuse_existing

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
    from vaoi_station.drift.recorded import check_recording
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
