"""`vaoi bench [--json FILE]`: measure the speed of stitching and rendering, of a whole station, and the accuracy."""

from __future__ import annotations

import math
from collections.abc import Callable
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
    marks: Annotated[
        bool, typer.Option("--marks", help="Measure accuracy and speed of the detection of marks.")
    ] = False,
    links: Annotated[bool, typer.Option("--links", help="Measure the bias of links towards whole pixels.")] = False,
    codes: Annotated[
        int | None,
        typer.Option(min=1, max=10_000, help="Read codes, printed and of dots, in this number of views of each kind."),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="With --marks, --links or --consistency: write a plot to this SVG file."),
    ] = None,
    consistency: Annotated[
        int | None, typer.Option(min=1, max=1000, help="Compare predicted and real errors of this number of boards.")
    ] = None,
    recordings: Annotated[
        Path | None, typer.Option(help="With --consistency: also use every recording with a truth in this directory.")
    ] = None,
    station: Annotated[
        bool, typer.Option("--station", help="Measure a whole station with boards in real time.")
    ] = False,
    rest: Annotated[
        bool, typer.Option("--rest", help="Measure callers of the REST interface while boards pass.")
    ] = False,
    growth: Annotated[
        bool, typer.Option("--growth", help="Measure time and memory over the length of the board.")
    ] = False,
    storage: Annotated[
        Path | None,
        typer.Option(help="Measure what it costs to keep a run on the disk of this directory."),
    ] = None,
    archive: Annotated[
        Path | None,
        typer.Option(help="Compare compressions of the frames of this recording, or of all in this directory."),
    ] = None,
    plant: Annotated[
        int | None,
        typer.Option(min=4, max=10_000, help="Stitch this number of archived runs on clusters of one and two workers."),
    ] = None,
    scenario: Annotated[
        str | None,
        typer.Option(help="With --station, --rest [paper] or --growth [small]: a shipped scenario, or a file."),
    ] = None,
    rates: Annotated[str, typer.Option(help="With --station: multiples of the scenario's own rate.")] = "1,2,4",
    boards: Annotated[int, typer.Option(min=1, max=1000, help="With --station: number of boards at each rate.")] = 6,
    workers: Annotated[
        int, typer.Option(min=1, max=64, help="With --station or --rest: number of worker processes.")
    ] = 2,
    rows: Annotated[str, typer.Option(help="With --growth: numbers of rows of three cameras.")] = "4,10,33,100,333",
    films: Annotated[
        Path | None, typer.Option(help="Keep rendered boards in this directory for the next call [not kept].")
    ] = None,
    ring: Annotated[Path, typer.Option(help="With --station or --rest: directory of the ring.")] = Path("/dev/shm"),  # noqa: S108  (as [ring] directory has it)
) -> None:
    """Measure stitching and rendering on frames in memory, in one thread, and compare with the paper's method.

    With --marks, --links, --codes, --consistency, --station, --rest, --growth, --storage, --archive or --plant, measure
    marks, links, printed codes, the predicted uncertainty, a whole station, its callers, the growth of time and memory,
    the cost of keeping runs, the compression of frames, or archived runs on a cluster.
    """
    from vaoi_station.files.documents import write_json

    kinds: dict[str, tuple[bool, Callable[[], dict[str, Any]]]] = {
        "--marks": (marks, lambda: _marks(plot)),
        "--links": (links, lambda: _links(plot)),
        "--codes": (codes is not None, lambda: _codes(codes or 0)),
        "--consistency": (consistency is not None, lambda: _consistency(consistency or 0, recordings, plot)),
        "--station": (
            station,
            lambda: _station(scenario or "paper", _numbers("--rates", rates), boards, workers, films, ring),
        ),
        "--rest": (rest, lambda: _rest(scenario or "paper", workers, films, ring)),
        "--growth": (
            growth,
            lambda: _growth(scenario or "small", tuple(int(n) for n in _numbers("--rows", rows)), films),
        ),
        "--storage": (storage is not None, lambda: _storage(case, storage or Path())),
        "--archive": (archive is not None, lambda: _archive(archive or Path())),
        "--plant": (plant is not None, lambda: _plant(case, plant or 0)),
    }
    chosen = [option for option, (given, _) in kinds.items() if given]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} exclude each other.", action="Give one of them.")
    if plot is not None and not marks and not links and consistency is None:
        raise InputError("--plot needs --marks, --links or --consistency.", action="Add one of them, or omit --plot.")
    document = kinds[chosen[0]][1]() if chosen else _stitching(case, repetitions)
    if json is not None:
        write_json(json, document)


def _stitching(case: Path | None, repetitions: int) -> dict[str, Any]:
    from vaoi_station.benchmarks.benchmark_board import board_from_recording, board_from_twin
    from vaoi_station.benchmarks.mosaic_speed import measure_mosaic
    from vaoi_station.benchmarks.stitch_speed import measure_stitching

    board = board_from_recording(case) if case else board_from_twin()
    document = measure_stitching(board, repetitions).document()
    # Without a CAD mapping (`failed`) there is no mosaic to measure.
    if document["cad_sigma_px"] is not None:
        document |= measure_mosaic(board, repetitions).document()
    for key, value in document.items():
        typer.echo(f"{key:28s} {value}")
    return document


def _storage(case: Path | None, directory: Path) -> dict[str, Any]:
    from vaoi_station.benchmarks.benchmark_board import board_from_recording, board_from_twin
    from vaoi_station.benchmarks.stitch_speed import stitch_board
    from vaoi_station.benchmarks.storage_cost import measure_storage
    from vaoi_station.files.results import stitch_text

    if (directory / "bench.db").exists():
        raise InputError(f"{directory / 'bench.db'}: exists.", action="Give an empty directory, or delete this file.")
    board = board_from_recording(case) if case else board_from_twin()
    figures = measure_storage(directory, stitch_text(stitch_board(board)), board.head.model_dump_json())
    for key, value in figures.document().items():
        typer.echo(f"{key:28s} {value}")
    return figures.document()


def _plant(case: Path | None, runs: int) -> dict[str, Any]:
    from vaoi_station.benchmarks.plant_speed import measure_plant

    if case is None:
        raise InputError("--plant needs --case.", action="Give a recording, whose copies are archived and stitched.")
    figures = measure_plant(case, runs, typer.echo)
    for line in figures.lines():
        typer.echo(line)
    return figures.document()


def _archive(folder: Path) -> dict[str, Any]:
    from vaoi_station.benchmarks.frame_compression import measure_compression

    figures = measure_compression(folder)
    for line in figures.lines():
        typer.echo(line)
    return figures.document()


def _marks(plot: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.accuracy.mark_accuracy import measure_marks
    from vaoi_station.files.documents import write_bytes

    figures = measure_marks()
    for line in figures.lines():
        typer.echo(line)
    typer.echo(f"whole frame ({figures.material}): {figures.whole_frame_ms} ms")
    if plot is not None:
        write_bytes(plot, figures.plot().encode())
    return figures.document()


def _links(plot: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.accuracy.subpixel_bias import measure_subpixel_bias
    from vaoi_station.files.documents import write_bytes

    figures = measure_subpixel_bias()
    for line in figures.lines():
        typer.echo(line)
    if plot is not None:
        write_bytes(plot, figures.plot().encode())
    return figures.document()


def _codes(views: int) -> dict[str, Any]:
    from vaoi_station.benchmarks.accuracy import code_reading, dotted_codes

    printed = code_reading.document(code_reading.measure_code_reading(views, report=typer.echo))
    return printed | {"dotted": dotted_codes.document(dotted_codes.measure_dotted_codes(views, report=typer.echo))}


def _consistency(count: int, recordings: Path | None, plot: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.accuracy.consistency import (
        recorded_runs,
        recordings_with_truth,
        summarise_runs,
        twin_runs,
    )
    from vaoi_station.benchmarks.accuracy.consistency_plot import draw_consistency
    from vaoi_station.files.documents import write_bytes

    found = recordings_with_truth(recordings) if recordings else []
    groups = {"twin": list(twin_runs(count, report=typer.echo)), "recordings": list(recorded_runs(found, typer.echo))}
    document = {name: summarise_runs(runs).document() for name, runs in groups.items() if runs}
    for name, figures in document.items():
        for key, value in figures.items():
            typer.echo(f"{name:12s} {key:24s} {value}")
    if plot is not None:
        write_bytes(plot, draw_consistency(groups["twin"], groups["recordings"]).encode())
    return document


def _station(
    scenario: str, rates: tuple[float, ...], boards: int, workers: int, films: Path | None, ring: Path
) -> dict[str, Any]:
    from vaoi_station.benchmarks.station.prerendered_run import prerender
    from vaoi_station.benchmarks.station.station_pace import PAUSE_S, measure_station_pace
    from vaoi_station.benchmarks.station.tables import process_table, station_table
    from vaoi_station.demo.temporary_folder import temporary_folder
    from vaoi_station.simulation import read_scenario

    # Boards that were rendered into --films are kept, because rendering a large board takes longer than all
    # measurements.
    with temporary_folder("bench") as temporary:
        board = prerender(read_scenario(_path(scenario)), (films or temporary) / Path(scenario).stem, typer.echo)
        figures = []
        for rate in rates:
            passing_s = board.head.rows * board.head.trigger_period_s + PAUSE_S
            about_s = math.ceil(boards * passing_s / rate)
            typer.echo(f"{boards} boards at {rate:g} times the scenario's rate: about {about_s} s.")
            folder = temporary / f"station-{rate:g}"
            figures.append(measure_station_pace(board, rate, boards, workers, folder, ring))
    typer.echo("\n" + station_table(figures) + "\n\n" + process_table(figures))
    return {"scenario": scenario, "workers": workers, "rates": [f.document() for f in figures]}


def _rest(scenario: str, workers: int, films: Path | None, ring: Path) -> dict[str, Any]:
    from vaoi_station.benchmarks.station.prerendered_run import prerender
    from vaoi_station.benchmarks.station.rest_pace import measure_rest
    from vaoi_station.demo.temporary_folder import temporary_folder
    from vaoi_station.simulation import read_scenario

    with temporary_folder("bench") as temporary:
        board = prerender(read_scenario(_path(scenario)), (films or temporary) / Path(scenario).stem, typer.echo)
        figures = measure_rest(board, workers, temporary / "rest", ring, typer.echo)
    for line in figures.lines():
        typer.echo(line)
    return {"scenario": scenario, "workers": workers, **figures.document()}


def _growth(scenario: str, rows: tuple[int, ...], films: Path | None) -> dict[str, Any]:
    from vaoi_station.benchmarks.station.scaling import measure_scaling
    from vaoi_station.benchmarks.station.tables import scaling_table
    from vaoi_station.demo.temporary_folder import temporary_folder
    from vaoi_station.simulation import read_scenario

    with temporary_folder("bench") as temporary:
        figures = measure_scaling(read_scenario(_path(scenario)), films or temporary, rows, typer.echo)
    typer.echo("\n" + scaling_table(figures))
    return {"scenario": scenario, "boards": [f.document() for f in figures]}


def _path(scenario: str) -> Path:
    from vaoi_station.simulation import find_scenario

    return find_scenario(scenario)


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
