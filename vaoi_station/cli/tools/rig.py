"""`vaoi rig up` and `vaoi rig run`: the station's real backends, on devices that are emulated."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

rig = typer.Typer(
    help="The virtual rig: the real firmware on an emulated chip, real GigE Vision on loopback, boards of the twin.",
    no_args_is_help=True,
)

SCENARIO = Annotated[str, typer.Option(help="Scenario file (TOML), or one by name: demo, small, paper.")]
CAMERAS = Annotated[int | None, typer.Option(min=1, max=200, help="In place of the scenario's; the board grows too.")]
FAULTS = Annotated[
    list[str] | None,
    typer.Option("--fault", help="NAME or NAME:KEY=VALUE,…; several may be given. `vaoi rig faults` lists them."),
]
FILMS = Annotated[Path | None, typer.Option(help="Where filmed boards are kept for the next time; else they are not.")]
DIFFERENT = Annotated[int, typer.Option(min=1, max=1000, help="Boards that are filmed; they pass in turn.")]


@rig.command()
def run(
    *,
    scenario: SCENARIO = "demo",
    cameras: CAMERAS = None,
    boards: Annotated[int, typer.Option(min=1, max=1000, help="How many pass.")] = 3,
    fault: FAULTS = None,
    films: FILMS = None,
    different: DIFFERENT = 3,
    workers: Annotated[int, typer.Option(min=1, max=64, help="The station's worker processes.")] = 2,
    json: Annotated[Path | None, typer.Option(help="Also write the report to this file.")] = None,
) -> None:
    """Start rig and service, let boards pass, score them against the truth, take all down; 1 if something is wrong."""
    from vaoi_station.demo.signal_handling import INTERRUPTED, interruptible
    from vaoi_station.demo.station_files import resolve_scenario
    from vaoi_station.files.documents import write_json
    from vaoi_station.rig.devices.firmware import check_sources
    from vaoi_station.rig.devices.network import enter_namespace
    from vaoi_station.rig.line.faults import check_faults, parse_fault
    from vaoi_station.rig.line.scenarios import check_supported, with_cameras
    from vaoi_station.rig.run import Plan, run_rig
    from vaoi_station.rig.scoring.tables import as_text
    from vaoi_station.simulation import read_scenario

    path, words = resolve_scenario(scenario), tuple(fault or ())
    plan = Plan(
        with_cameras(read_scenario(path), cameras),
        path.stem,
        boards,
        tuple(map(parse_fault, words)),
        words,
        films,
        min(different, boards),
        workers,
    )
    check_supported(plan.scenario)
    check_faults(plan.faults, plan.scenario.array.cameras, boards)
    check_sources()
    enter_namespace()
    try:
        with interruptible():
            report = run_rig(plan, lambda line: typer.echo(line, err=True))
    except KeyboardInterrupt:
        raise typer.Exit(INTERRUPTED) from None
    typer.echo(as_text(report))
    if json is not None:
        write_json(json, report.model_dump(mode="json"))
    raise typer.Exit(0 if report.ok else 1)


@rig.command()
def up(
    *,
    out: Annotated[Path, typer.Option(help="A new or empty directory for station.toml, port and data.")],
    scenario: SCENARIO = "demo",
    cameras: CAMERAS = None,
    fault: FAULTS = None,
    films: FILMS = None,
    different: DIFFERENT = 3,
    still: Annotated[
        bool, typer.Option("--still", help="No board passes: for `vaoi record --still`, to calibrate.")
    ] = False,
    own_network: Annotated[
        bool, typer.Option("--own-network", help="Do not touch this machine's loopback, even if that is allowed.")
    ] = False,
) -> None:
    """Devices only, until Ctrl-C: start `vaoi serve` beside them, with the station.toml that is written."""
    from vaoi_station.demo.signal_handling import interruptible
    from vaoi_station.demo.station_files import resolve_scenario
    from vaoi_station.errors import InputError
    from vaoi_station.rig.devices.firmware import check_sources
    from vaoi_station.rig.devices.network import enter_namespace, may_add_addresses
    from vaoi_station.rig.line.faults import check_faults, parse_fault
    from vaoi_station.rig.line.scenarios import check_supported, with_cameras
    from vaoi_station.rig.up import run_until_interrupted
    from vaoi_station.simulation import read_scenario

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: must be a new or empty directory.", action="Give another --out.")
    faults = tuple(map(parse_fault, fault or ()))
    chosen = with_cameras(read_scenario(resolve_scenario(scenario)), cameras)
    check_supported(chosen)
    check_faults(faults, chosen.array.cameras, different)
    check_sources()
    if own_network or not may_add_addresses():
        enter_namespace()
    out.mkdir(parents=True, exist_ok=True)
    try:
        with interruptible():
            run_until_interrupted(
                chosen, faults, out.resolve(), (films or out / "films").resolve(), different, typer.echo, still=still
            )
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


@rig.command()
def faults() -> None:
    """What can go wrong, and its keys with their defaults."""
    from vaoi_station.rig.line.faults import KINDS

    for name, (fault, keys, what) in KINDS.items():
        shown = ",".join(f"{key}={getattr(fault, key)}" for key in keys)
        typer.echo(f"{name:8s} {shown:44s} {what}")
