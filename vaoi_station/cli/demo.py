"""`vaoi demo`: run the whole service on the digital twin."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer


def demo(
    *,
    scenario: Annotated[
        str, typer.Option(help="Scenario file (TOML), or the name of a shipped scenario: demo, small.")
    ] = "demo",
    board: Annotated[
        Path | None, typer.Option(help="Board type (board.json) that is filmed, for example of vaoi import.")
    ] = None,
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Port of the service, 0: any free one [8350; with --once any]."),
    ] = None,
    once: Annotated[bool, typer.Option("--once", help="Film one board, print a report, and exit.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="With --once: write the output to this directory [vaoi-demo].")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="With --once: print one JSON document.")] = False,
) -> None:
    """Run the whole station with simulated cameras, board after board, until Ctrl-C."""
    from vaoi_station.demo.signal_handling import INTERRUPTED, interruptible
    from vaoi_station.errors import InputError

    if not once and (as_json or out is not None):
        raise InputError("--out and --json need --once.", action="Add --once, or omit them.")
    code = 0
    try:
        with interruptible(), tempfile.TemporaryDirectory(prefix="vaoi-board-") as folder:
            if once:
                code = _once(scenario, board, Path(folder), out or Path("vaoi-demo"), port or 0, as_json=as_json)
            else:
                from vaoi_station.demo.boards import run_continuously

                path = _scenario(scenario, board, Path(folder))
                run_continuously(path, port, lambda line: print(line, flush=True))
    except KeyboardInterrupt:
        # Ctrl-C is the normal end of the endless demo, but it cuts a single board short.
        code = INTERRUPTED if once else 0
    raise typer.Exit(code)


def _once(scenario: str, board: Path | None, folder: Path, out: Path, port: int, *, as_json: bool) -> int:
    from vaoi_station.demo.service import Service

    station = folder / "station"
    station.mkdir()
    # The service imports for as long as this process does, and a computer has two cores.
    with Service(station / "station.toml", port).importing() as service:
        from vaoi_station.demo.boards import film_single_board
        from vaoi_station.demo.report import as_text

        path = _scenario(scenario, board, folder)
        # The lines of progress are no part of the report: stdout may be one JSON document.
        report = film_single_board(path, out, service, lambda line: print(line, file=sys.stderr, flush=True))
    print(report.model_dump_json(indent=1) if as_json else as_text(report))
    return 0 if report.ok else 1


def _scenario(given: str, board: Path | None, folder: Path) -> Path:
    from vaoi_station.demo.given_board import write_given_scenario
    from vaoi_station.simulation import find_scenario

    path = find_scenario(given)
    return path if board is None else write_given_scenario(board, path, folder)
