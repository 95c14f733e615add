"""Film one board with the whole service, compare the result with the truth, and write the output files."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from vaoi_station.demo.client import Client
from vaoi_station.demo.component_images import ComponentImages, fetch_component_images, list_unseen_components
from vaoi_station.demo.demo_report import DemoReport, headline
from vaoi_station.demo.evaluation import Output, ServiceReplies, evaluate
from vaoi_station.demo.service import Service, refuse_taken_port
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.temporary_folder import temporary_folder
from vaoi_station.demo.waiting import wait_for_run, wait_until_idle
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.files.documents import write_json
from vaoi_station.files.images import write_image
from vaoi_station.model import Status
from vaoi_station.rendering.contact_sheet import contact_sheet

REPORT, SHEET, PICTURES, MATRICES = "report.json", "contact-sheet.png", "components", "matrices.json"


def film_single_board(scenario: Path, out: Path, port: int = 0) -> DemoReport:
    """Film one board and write report, matrices, component images and contact sheet to `out`.

    Args:
        scenario: file of the twin's scenario.
        out: a new or empty directory, or the output of an earlier demo.
        port: port of the service; 0 for any free one.

    Raises:
        InputError: `out` holds other files.
        DeviceError: the port is in use, the service does not start, or it films nothing.
    """
    started_s = time.monotonic()
    refuse_taken_port(port)
    prepare_output(out)
    with temporary_folder("demo") as folder:
        config, twin = write_station_files(scenario, folder, boards=1)
        with Service(config, port) as service:
            client = Client(service.address)
            wait_until_idle(client)
            client.post("/station/arm", board_type=twin.board_type.name, board_id="1", job_id="demo", runs=1)
            replies = _request_results(client)
            concluded_s = time.monotonic()
            images = _component_images(client, replies, out)
            pictures_s = time.monotonic() - concluded_s
    took_s = time.monotonic() - started_s
    output = Output(str(out), str(out / SHEET), images.components, images.pictures, pictures_s, took_s)
    report = evaluate(scenario.stem, replies, twin.passage(0), output)
    sheet = contact_sheet(images.tiles, f"Board type {report.board_type}", report.status, headline(report))
    write_image(out / SHEET, sheet, level=9)
    write_json(out / MATRICES, replies.matrices)
    # The report comes last: `prepare_output` takes it as the sign that a demo wrote this directory completely.
    write_json(out / REPORT, report.model_dump(mode="json"))
    return report


def prepare_output(out: Path) -> None:
    """Delete the output of an earlier demo; other files stay.

    Raises:
        InputError: `out` is a file, or a directory that no demo has written.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file, must be a directory.", action="Give another --out.")
    if not out.exists() or not any(out.iterdir()):
        return
    if not (out / REPORT).is_file():
        raise InputError(f"{out}: holds files that no demo has written.", action="Give another --out, or remove it.")
    shutil.rmtree(out / PICTURES, ignore_errors=True)
    for name in (SHEET, MATRICES, REPORT):
        (out / name).unlink(missing_ok=True)


def _request_results(client: Client) -> ServiceReplies:
    """Wait for the board and request its matrices; a run that failed early has none."""
    run = wait_for_run(client, None)
    try:
        return ServiceReplies(run, client.get(f"/runs/{run['id']}/matrices"))
    except NotFoundError:
        return ServiceReplies(run, {})


def _component_images(client: Client, replies: ServiceReplies, out: Path) -> ComponentImages:
    """Fetch the component images; a failed run has none, because it has no positions."""
    if replies.run["verdict"] == Status.FAILED:
        return list_unseen_components(client, replies.run["id"])
    return fetch_component_images(client, replies.run["id"], out / PICTURES)
