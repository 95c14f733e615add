"""`vaoi bench [--json FILE]`: measure the speed of stitching and rendering, of a whole station, and the accuracy."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from vaoi_station.errors import InputError


def bench(
    json: Annotated[Path | None, typer.Option(help="Also write the figures to this file.")] = None,
    case: Annotated[Path | None, typer.Option(help="Measure on this recording [a board of the twin].")] = None,
    repetitions: Annotated[
        int, typer.Option(min=1, max=100, help="Repeat each measurement this number of times; the median counts.")
    ] = 5,
    profile: Annotated[
        bool, typer.Option("--profile", help="Show where the CPU time of a board goes, per frame and after the last.")
    ] = False,
    compiling: Annotated[
        bool, typer.Option("--compile", help="With --profile: measure instead how long each function compiles.")
    ] = False,
    consistency: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Compare predicted and real errors of this number of boards.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="With --consistency: also use every recording with a truth in this directory.")
    ] = None,
    station: Annotated[
        bool, typer.Option("--station", help="Measure a whole station with boards in real time.")
    ] = False,
    scenario: Annotated[
        str | None, typer.Option(help="With --station [paper] or --profile [demo]: a shipped scenario, or a file.")
    ] = None,
    rates: Annotated[str, typer.Option(help="With --station: multiples of the scenario's own rate.")] = "1,2,4",
    boards: Annotated[int, typer.Option(min=1, max=1000, help="With --station: number of boards at each rate.")] = 6,
    workers: Annotated[int, typer.Option(min=1, max=64, help="With --station: number of worker processes.")] = 2,
    films: Annotated[
        Path | None,
        typer.Option(help="With --station: keep rendered boards here for the next call [not kept]."),
    ] = None,
    ring: Annotated[Path, typer.Option(help="With --station: directory of the ring.")] = Path("/dev/shm"),  # noqa: S108  (as [ring] directory has it)
) -> None:
    """Measure stitching and rendering on frames in memory, in one thread, and compare with the paper's method.

    With --profile, --consistency or --station, show where the time of stitching goes, or measure the predicted
    uncertainty or a whole station.
    """
    kinds: dict[str, tuple[object, Callable[[], dict[str, Any]]]] = {
        "--profile": (profile, lambda: _profile(case, scenario, repetitions, compiling=compiling)),
        "--consistency": (consistency, lambda: _consistency(consistency or 0, recordings)),
        "--station": (
            station,
            lambda: _station(scenario or "paper", _numbers("--rates", rates), boards, workers, films, ring),
        ),
    }
    chosen = [option for option, (given, _) in kinds.items() if given]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} exclude each other.", action="Give one of them.")
    if compiling and (not profile or case is not None):
        raise InputError("--compile measures a scenario.", action="Give --profile --compile, and no --case.")
    document = kinds[chosen[0]][1]() if chosen else _stitching(case, repetitions)
    if json is not None:
        from vaoi_station.files.documents import write_json

        write_json(json, document)


def _stitching(case: Path | None, repetitions: int) -> dict[str, Any]:
    from vaoi_station.benchmarks.boards import board_from_recording, board_from_twin
    from vaoi_station.benchmarks.speed import measure_mosaic, measure_stitching

    board = board_from_recording(case) if case else board_from_twin()
    document = asdict(measure_stitching(board, repetitions))
    # Without a CAD mapping (`failed`) there is no mosaic to measure.
    if document["cad_sigma_px"] is not None:
        document |= asdict(measure_mosaic(board, repetitions))
    for key, value in document.items():
        typer.echo(f"{key:28s} {value}")
    return document


def _profile(case: Path | None, scenario: str | None, repetitions: int, *, compiling: bool) -> dict[str, Any]:
    from vaoi_station.benchmarks.boards import board_from_recording, board_from_twin
    from vaoi_station.benchmarks.profile import compiling_table, measure_compiling, measure_profile

    if compiling:
        figures = measure_compiling(scenario or "small")
        typer.echo(compiling_table(figures))
        return {"compiled": figures}
    board = board_from_recording(case) if case else board_from_twin(scenario or "demo")
    profile = measure_profile(board, repetitions)
    typer.echo(profile.text())
    return asdict(profile)


def _consistency(count: int, recordings: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.uncertainty import recorded_runs, recordings_with_truth, summarise_runs, twin_runs

    found = recordings_with_truth(recordings) if recordings else []
    groups = {"twin": list(twin_runs(count, report=typer.echo)), "recordings": list(recorded_runs(found, typer.echo))}
    document = {name: summarise_runs(runs).document() for name, runs in groups.items() if runs}
    for name, figures in document.items():
        for key, value in figures.items():
            typer.echo(f"{name:12s} {key:24s} {value}")
    return document


def _station(
    scenario: str, rates: tuple[float, ...], boards: int, workers: int, films: Path | None, ring: Path
) -> dict[str, Any]:
    from vaoi_station.benchmarks.station_pace import (
        PAUSE_S,
        measure_station_pace,
        prerender,
        process_table,
        station_table,
    )
    from vaoi_station.simulation import find_scenario, read_scenario

    # Boards that were rendered into --films are kept, because rendering a large board takes longer than all
    # measurements.
    with tempfile.TemporaryDirectory(prefix="vaoi-bench-") as made:
        temporary = Path(made)
        scene = read_scenario(find_scenario(scenario))
        board = prerender(scene, (films or temporary) / Path(scenario).stem, typer.echo)
        figures = []
        for rate in rates:
            passing_s = board.head.rows * board.head.trigger_period_s + PAUSE_S
            about_s = math.ceil(boards * passing_s / rate)
            typer.echo(f"{boards} boards at {rate:g} times the scenario's rate: about {about_s} s.")
            folder = temporary / f"station-{rate:g}"
            figures.append(measure_station_pace(board, rate, boards, workers, folder, ring))
    typer.echo("\n" + station_table(figures) + "\n\n" + process_table(figures))
    return {"scenario": scenario, "workers": workers, "rates": [f.document() for f in figures]}


def _numbers(option: str, given: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in given.split(","))
    except ValueError:
        numbers = ()
    if not numbers or not all(0 < n <= 10_000 for n in numbers):
        raise InputError.field(
            "vaoi bench", option, given, "a comma-separated list of numbers above 0 and at most 10000"
        )
    return numbers
