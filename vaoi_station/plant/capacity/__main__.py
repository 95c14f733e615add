"""`python -m vaoi_station.plant.capacity`: print what a plant needs, and how long requests wait."""

from __future__ import annotations

from typing import Annotated

import typer

from vaoi_station.plant.capacity.figures import Measured, Plant, figures
from vaoi_station.plant.capacity.queueing import Requests, simulate

_M, _P = Measured(), Plant()
_KILLED_PER_HOUR = 0.1
"""How often a worker ends in mid-run."""


def main(
    stations: Annotated[int, typer.Option(min=1, help="Number of stations.")] = _P.stations,
    frames: Annotated[float, typer.Option(min=1, help="Number of frames that are kept.")] = _P.frames,
    boards_per_hour: Annotated[float, typer.Option(min=0.01, help="Boards of a station.")] = _P.boards_per_hour,
    workers: Annotated[int, typer.Option(min=1, max=100_000, help="Number of workers.")] = _P.workers,
    task_s: Annotated[float, typer.Option(min=0.001, help="CPU time of a run, s.")] = _M.task_cpu_s,
    requests_per_hour: Annotated[float, typer.Option(min=0, help="Requests to stitch runs again.")] = 4.0,
    runs: Annotated[float, typer.Option(min=1, help="Mean number of runs of a request.")] = 5000.0,
    seed: Annotated[int, typer.Option(help="Seed of the simulation.")] = 1,
) -> None:
    """Print rates, sizes and cost of a plant, and the waits of requests with half, as many and twice the workers."""
    measured = _M._replace(task_cpu_s=task_s)
    plant = _P._replace(stations=stations, frames=frames, boards_per_hour=boards_per_hour, workers=workers)
    for name, value in figures(measured, plant)._asdict().items():
        typer.echo(f"{name:18s} {value:14,.2f}")
    typer.echo("")
    typer.echo("| workers | busy | first run begins after (median, 95 %) s | request ends after (median, 95 %) s |")
    typer.echo("|---|---|---|---|")
    # Tasks vary by the number of frames of a board: half and twice the mean are as frequent.
    times_s = [task_s * factor / 1.125 for factor in (0.5, 1.0, 1.0, 2.0)]
    for count in sorted({max(1, workers // 2), workers, workers * 2}):
        wait = simulate(Requests(requests_per_hour, runs), count, times_s, killed_per_hour=_KILLED_PER_HOUR, seed=seed)
        typer.echo(
            f"| {count} | {wait.busy:.0%} | {wait.start_p50_s:.0f}, {wait.start_p95_s:.0f} "
            f"| {wait.end_p50_s:.0f}, {wait.end_p95_s:.0f} |"
        )


if __name__ == "__main__":
    typer.run(main)
