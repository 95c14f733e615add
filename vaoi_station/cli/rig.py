"""`vaoi rig up` and `vaoi rig run`: run the station's real backends on emulated devices."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

rig = typer.Typer(
    help="The virtual rig: the real firmware on an emulated chip, real GigE Vision on loopback, boards of the twin.",
    no_args_is_help=True,
)

SCENARIO = Annotated[
    str, typer.Option(help="Scenario file (TOML), or the name of a shipped scenario: demo, small, paper.")
]
CAMERAS = Annotated[
    int | None, typer.Option(min=1, max=200, help="Number of cameras instead of the scenario's; the board grows too.")
]
FAULTS = Annotated[
    list[str] | None,
    typer.Option(
        "--fault", help="Inject a fault: NAME or NAME:KEY=VALUE,…; repeat for several. `vaoi rig faults` lists them."
    ),
]
DESCRIPTIONS = Annotated[
    list[Path] | None,
    typer.Option(
        "--description",
        help="GenICam description (.xml, .xml.gz) of the cameras; repeat for several, one per camera in turn.",
    ),
]
FILMS = Annotated[
    Path | None, typer.Option(help="Keep rendered boards in this directory for the next call [not kept].")
]
DIFFERENT = Annotated[int, typer.Option(min=1, max=1000, help="Number of different boards; they pass in turn.")]


@rig.command()
def run(
    *,
    scenario: SCENARIO = "demo",
    cameras: CAMERAS = None,
    boards: Annotated[int, typer.Option(min=1, max=1000, help="Number of boards that pass.")] = 3,
    fault: FAULTS = None,
    description: DESCRIPTIONS = None,
    films: FILMS = None,
    different: DIFFERENT = 3,
    workers: Annotated[int, typer.Option(min=1, max=64, help="Number of worker processes of the station.")] = 2,
    json: Annotated[Path | None, typer.Option(help="Also write the report to this file.")] = None,
) -> None:
    """Start rig and service, let boards pass, score the results with the truth, and stop; exit code 1 on a failure."""
    from vaoi_station.demo.signal_handling import INTERRUPTED, interruptible
    from vaoi_station.files.documents import write_json
    from vaoi_station.rig.chip import check_sources
    from vaoi_station.rig.faults import check_faults, parse_fault
    from vaoi_station.rig.line import check_supported, with_cameras
    from vaoi_station.rig.network import enter_namespace
    from vaoi_station.rig.report import text_lines
    from vaoi_station.rig.run import Plan, run_rig
    from vaoi_station.rig.virtual_camera import read_description
    from vaoi_station.simulation import find_scenario, read_scenario

    path, words = find_scenario(scenario), tuple(fault or ())
    plan = Plan(
        with_cameras(read_scenario(path), cameras),
        path.stem,
        boards,
        tuple(map(parse_fault, words)),
        words,
        films,
        min(different, boards),
        workers,
        tuple(description or ()),
    )
    check_supported(plan.scenario)
    check_faults(plan.faults, plan.scenario.array.cameras, boards)
    check_sources()
    for file in description or ():
        read_description(file)
    enter_namespace()
    try:
        with interruptible():
            report = run_rig(plan, lambda line: typer.echo(line, err=True))
    except KeyboardInterrupt:
        # An interrupted run has no score, so it must not count as passed.
        raise typer.Exit(INTERRUPTED) from None
    typer.echo("\n".join(text_lines(report)))
    if json is not None:
        write_json(json, report.model_dump(mode="json"))
    raise typer.Exit(0 if report.ok else 1)


@rig.command()
def up(
    *,
    out: Annotated[Path, typer.Option(help="Write station.toml, port and data to this new or empty directory.")],
    scenario: SCENARIO = "demo",
    cameras: CAMERAS = None,
    fault: FAULTS = None,
    description: DESCRIPTIONS = None,
    films: FILMS = None,
    different: DIFFERENT = 3,
    still: Annotated[
        bool, typer.Option("--still", help="Let no board pass; for `vaoi record --still`, to calibrate.")
    ] = False,
    own_network: Annotated[
        bool,
        typer.Option(
            "--own-network", help="Use an own network name space, even if this machine's loopback may be changed."
        ),
    ] = False,
) -> None:
    """Run only the devices, until Ctrl-C; start `vaoi serve` beside them with the station.toml that is written."""
    from vaoi_station.demo.signal_handling import interruptible
    from vaoi_station.errors import InputError
    from vaoi_station.rig.chip import check_sources
    from vaoi_station.rig.faults import check_faults, parse_fault
    from vaoi_station.rig.line import check_supported, with_cameras
    from vaoi_station.rig.network import enter_namespace, may_add_addresses
    from vaoi_station.rig.run import run_until_interrupted
    from vaoi_station.rig.virtual_camera import read_description
    from vaoi_station.simulation import find_scenario, read_scenario

    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(f"{out}: is not a new or empty directory.", action="Give another --out.")
    faults = tuple(map(parse_fault, fault or ()))
    chosen = with_cameras(read_scenario(find_scenario(scenario)), cameras)
    check_supported(chosen)
    check_faults(faults, chosen.array.cameras, different)
    check_sources()
    for file in description or ():
        read_description(file)
    # To add addresses to loopback needs a privilege. Inside a new network name space the process has it.
    if own_network or not may_add_addresses():
        enter_namespace()
    out.mkdir(parents=True, exist_ok=True)
    try:
        with interruptible():
            run_until_interrupted(
                chosen,
                faults,
                out.resolve(),
                (films or out / "films").resolve(),
                different,
                typer.echo,
                still=still,
                descriptions=tuple(file.resolve() for file in description or ()),
            )
    except KeyboardInterrupt:
        raise typer.Exit(0) from None


@rig.command()
def faults() -> None:
    """List the faults that can be injected, and their keys with defaults."""
    from vaoi_station.rig.faults import KINDS

    for name, (fault, keys, what) in KINDS.items():
        shown = ",".join(f"{key}={getattr(fault, key)}" for key in keys)
        typer.echo(f"{name:8s} {shown:44s} {what}")
