"""One board through the whole service: filmed, stitched, cut, compared with the truth, put on a contact sheet."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from vaoi_station.demo.client import Client
from vaoi_station.demo.component_images import ComponentImages, fetch_component_images, list_unseen_components
from vaoi_station.demo.demo_report import DemoReport, headline
from vaoi_station.demo.evaluation import Output, ServiceReplies, evaluate
from vaoi_station.demo.service import Service
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
    """Film one board and leave report, matrices, component pictures and contact sheet in `out`.

    Args:
        scenario: of the twin.
        out: a new or empty directory, or one an earlier demo has written.
        port: of the service; 0: any that is free.

    Raises:
        InputError: `out` holds something else.
        DeviceError: the service does not come up, or films nothing.
    """
    began_s = time.monotonic()
    clear(out)
    with temporary_folder("demo") as folder:
        config, twin = write_station_files(scenario, folder, boards=1)
        with Service(config, port) as service:
            client = Client(service.address)
            wait_until_idle(client)
            client.post("/station/arm", board_type=twin.board_type.name, board_id="1", job_id="demo", runs=1)
            answers = _ask(client)
            asked_s = time.monotonic()
            gallery = _gallery(client, answers, out)
            pictures_s = time.monotonic() - asked_s
    took_s = time.monotonic() - began_s
    output = Output(str(out), str(out / SHEET), gallery.components, gallery.pictures, pictures_s, took_s)
    report = evaluate(scenario.stem, answers, twin.passage(0), output)
    sheet = contact_sheet(gallery.tiles, f"Board type {report.board_type}", report.status, headline(report))
    write_image(out / SHEET, sheet, level=9)
    write_json(out / MATRICES, answers.matrices)
    write_json(out / REPORT, report.model_dump(mode="json"))
    return report


def clear(out: Path) -> None:
    """Make room for a demo's output; what no demo has written is not touched.

    Raises:
        InputError: there is something else.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out}: is a file, must be a directory.", action="Give another --out.")
    if not out.exists() or not any(out.iterdir()):
        return
    if not (out / REPORT).is_file():
        raise InputError(f"{out}: holds something no demo has written.", action="Give another --out, or remove it.")
    shutil.rmtree(out / PICTURES, ignore_errors=True)
    for name in (SHEET, MATRICES, REPORT):
        (out / name).unlink(missing_ok=True)


def _ask(client: Client) -> ServiceReplies:
    """Wait for the board, and ask for its matrices; a run may have failed before there were any."""
    run = wait_for_run(client, None)
    try:
        return ServiceReplies(run, client.get(f"/runs/{run['id']}/matrices"))
    except NotFoundError:
        return ServiceReplies(run, {})


def _gallery(client: Client, answers: ServiceReplies, out: Path) -> ComponentImages:
    """Nothing can be cut out of a run that has failed."""
    if answers.run["verdict"] == Status.FAILED:
        return list_unseen_components(client, answers.run["id"])
    return fetch_component_images(client, answers.run["id"], out / PICTURES)
