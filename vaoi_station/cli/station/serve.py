"""`vaoi serve --config station.toml`: run the whole service."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def serve(
    config: Annotated[Path, typer.Option(help="Run the station of this station.toml.")] = Path("station.toml"),
    port: Annotated[
        int | None,
        typer.Option(min=0, max=65535, help="Listen at this port instead of the configured one; 0: any free one."),
    ] = None,
    log_json: Annotated[bool, typer.Option("--log-json", help="Log JSON objects, one per line.")] = False,
) -> None:
    """Film boards, stitch them, and serve results by REST, until Ctrl-C or SIGTERM."""
    from vaoi_station.runs.host.processes import no_collections

    with no_collections():
        from vaoi_station import station
        from vaoi_station.acquisition.process.backends import check_backends
        from vaoi_station.config import read_config
        from vaoi_station.runs.host.logs import configure_logging
        from vaoi_station.runs.host.processes import set_process_title

    settings = read_config(config)
    # Checked before processes start: a wrong scenario gives one error here, but would give endless restarts later.
    check_backends(settings)
    set_process_title("vaoi", arguments=False)
    configure_logging(log_json)
    station.serve(settings, port, config)
