"""`vaoi record`: film boards and keep them as recordings, without stitching and REST."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

STILL_RATE_HZ = 1.0
"""Pulse rate for several pictures of a board at rest."""


def record(
    config: Annotated[Path, typer.Option(help="Read cameras, controller and line from this station.toml.")],
    out: Annotated[
        Path, typer.Option(help="Write the recording to this directory; several runs to its subdirectories run-001 ….")
    ],
    runs: Annotated[int, typer.Option(min=1, help="Film this number of boards.")] = 1,
    still: Annotated[
        bool, typer.Option("--still", help="Fire one pulse at once, without the light barrier: a board at rest.")
    ] = False,
) -> None:
    """Film boards with the configured devices and keep each as a recording."""
    from vaoi_station.acquisition.process.filming import FilmingHandlers, export_run, film, film_pulses
    from vaoi_station.acquisition.process.messages import RunFinished
    from vaoi_station.acquisition.ring import Ring
    from vaoi_station.config import read_config
    from vaoi_station.files import read_calibration
    from vaoi_station.files.atomic_directory import refuse_existing

    station = read_config(config)
    copies = {"calibration.json": station.calibration}
    if still and not station.calibration.exists():
        # The first calibration is made from such a recording, so no calibration can be required here.
        copies = {}
    else:
        read_calibration(station.calibration, [c.head for c in station.cameras])
    targets = [out] if runs == 1 else [out / f"run-{n:03d}" for n in range(1, runs + 1)]
    # All targets are checked before the first board: a board on the line cannot be filmed again.
    refuse_existing(*targets)
    kept: list[Path] = []

    def keep(finished: RunFinished, ring: Ring, generation: int) -> None:
        target = targets[len(kept)]
        export_run(target, finished, ring, generation, copies)
        kept.append(target)
        cameras, rows = len(station.cameras), finished.head.rows
        whole = cameras * rows - len(finished.head.missing)
        print(f"{target}: {rows} rows, {whole} of {cameras * rows} frames, ended by {finished.reason!r}")
        for frame in finished.frames:
            if frame.cause:
                print(f"  camera {frame.camera}, row {frame.row}: {frame.verdict}: {frame.cause}")

    def notice(sentence: str) -> None:
        # stderr, because stdout lists the recordings.
        print(sentence, file=sys.stderr)

    if still:
        film_pulses(station, runs, STILL_RATE_HZ, FilmingHandlers(keep, notice))
    else:
        film(station, runs, FilmingHandlers(keep, notice))
