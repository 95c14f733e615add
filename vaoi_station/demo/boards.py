"""Film boards of the twin with the whole service: one with all its pictures and a report, or board after board."""

from __future__ import annotations

import io
import json
import shlex
import shutil
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NoReturn

from vaoi_station.config import ApiConfig
from vaoi_station.demo.client import Client
from vaoi_station.demo.report import DemoReport, evaluate, headline
from vaoi_station.demo.service import Service, refuse_taken_port
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.waiting import poll, wait_for_run, wait_until_idle
from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files.contact_sheet import Tile, contact_sheet
from vaoi_station.files.documents import write_json
from vaoi_station.files.images import decode, write_image
from vaoi_station.model import BoardType, Status

REPORT, SHEET, PICTURES, MATRICES = "report.json", "contact-sheet.png", "components", "matrices.json"


def film_single_board(
    scenario: Path, out: Path, service: Service, say: Callable[[str], object] = lambda _: None
) -> DemoReport:
    """Film one board and write report, matrices, component images and contact sheet to `out`.

    Args:
        scenario: file of the twin's scenario.
        out: a new or empty directory, or the output of an earlier demo.
        service: its process imports meanwhile; its station.toml and all other files are written here.
        say: is called with one line per stage.

    Raises:
        InputError: `out` holds other files.
        DeviceError: the port is in use, the service does not start, or it films nothing.
    """
    started_s = time.monotonic()

    def stage(text: str) -> None:
        say(f"{time.monotonic() - started_s:5.1f} s  {text}")

    refuse_taken_port(service.port)
    prepare_output(out)
    _, twin = write_station_files(scenario, service.config.parent, boards=1)
    stage("The station starts; its line renders the frames of the first board meanwhile.")
    with service:
        client = Client(service.address)
        wait_until_idle(client, stage)
        client.post("/station/arm", board_type=twin.board_type.name, board_id="1", job_id="demo", runs=1)
        stage("The station is ready and armed; the board comes when its frames are rendered.")
        run = wait_for_run(client, None)
        stage(f"The board is filmed and stitched: {run['verdict']}.")
        try:
            matrices = client.get(f"/runs/{run['id']}/matrices")
        except NotFoundError:  # the run has failed early
            matrices = {}
        concluded_s = time.monotonic()
        tiles, pictures = fetch_component_images(client, run, twin.board_type, out / PICTURES)
        pictures_s = time.monotonic() - concluded_s
        stage(f"The pictures of the board are there: {out / PICTURES}")
        service.request_end()  # it ends while the report is written
        report = evaluate(
            scenario.stem,
            run,
            matrices,
            twin.passage(0),
            components=len(tiles),
            pictures=pictures,
            pictures_s=round(pictures_s, 3),
            total_s=round(time.monotonic() - started_s, 3),
            out=str(out),
            contact_sheet=str(out / SHEET),
        )
        title, status = f"Board type {run['board_type']}", Status(run["verdict"])
        write_image(out / SHEET, contact_sheet(tiles, title, status, headline(report)))
        write_json(out / MATRICES, matrices)
        # The report comes last: `prepare_output` takes it as the sign that a demo wrote this directory completely.
        write_json(out / REPORT, report.model_dump(mode="json"))
        stage(f"All of them are on one sheet: {out / SHEET}")
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


def fetch_component_images(
    client: Client, run: dict[str, Any], board_type: BoardType, folder: Path
) -> tuple[list[Tile], int]:
    """Write every image of every component to `folder`/REF/NN_cCC_rRRR.png, and its matrices to REF/views.json.

    Returns:
        The best image of every component, in the order of the board type, and the number of images. A failed run has
        no images, because it has no positions.

    Raises:
        DeviceError: the station could not send all images.
    """
    # Not from `runs/{id}/components`: the station would load its machine code only to choose the views that it lists.
    addresses = [component.address for component in board_type.components]
    if run["verdict"] == Status.FAILED:
        return [Tile(None, address, "not seen") for address in addresses], 0
    path, tiles, pictures = f"/runs/{run['id']}/images", dict[str, Tile](), 0
    with zipfile.ZipFile(io.BytesIO(client.content(path, container="zip"))) as files:
        end = json.loads(files.read("end.json"))
        if not end["complete"]:
            raise DeviceError(f"{client.url(path)}: {end['error']['message']}", action=end["error"]["action"])
        for name in files.namelist():
            if name.endswith("/views.json"):
                component = json.loads(files.read(name))
                tiles[component["address"]] = _written(files, component, folder)
                pictures += len(component["views"])
    return [tiles[address] for address in addresses], pictures


def _written(files: zipfile.ZipFile, component: dict[str, Any], folder: Path) -> Tile:
    """Write the images of one component, and return the best of them as a tile."""
    address, views = component["address"], component["views"]
    # On a panel the address is panel/ref. In a file name the slash would create a folder.
    place = folder / address.replace("/", "_")
    place.mkdir(parents=True, exist_ok=True)
    contents = [files.read(view.pop("file")) for view in views]
    for view, content in zip(views, contents, strict=True):
        (place / f"{view['k']:02d}_c{view['camera']:02d}_r{view['row']:03d}.png").write_bytes(content)
    write_json(place / "views.json", views)
    if not views:
        return Tile(None, address, "not seen")
    # views are sorted by quality
    return Tile(decode(contents[0]), address, f"c{views[0]['camera']} r{views[0]['row']}")


def run_continuously(scenario: Path, port: int | None, report: Callable[[str], None]) -> NoReturn:
    """Run the station and report every board until KeyboardInterrupt; then end its processes and remove its files.

    Args:
        scenario: file of the twin's scenario.
        port: port of the service; None for the default port, 0 for any free port.
        report: is called with one line per board.

    Raises:
        DeviceError: the port is in use.
    """
    port = ApiConfig().port if port is None else port
    # Another station may already run here. A program that expects the demo at this port would talk to that station.
    refuse_taken_port(port)
    report("Drawing the board …")
    with tempfile.TemporaryDirectory(prefix="vaoi-demo-") as folder:
        config, twin = write_station_files(scenario, Path(folder))
        with Service(config, port) as service:
            client = Client(service.address)
            report(f"The station's page: {service.address}/  (REST: {service.address}/docs). Ctrl-C ends it.")
            given = shlex.quote(str(config))
            report(f"A key for the pages under Set up: vaoi keys create me --scope admin --config {given}")
            wait_until_idle(client, report)
            client.post("/station/arm", board_type=twin.board_type.name, job_id="demo")
            number, after = 0, None
            while True:
                run = poll(client, after)
                if run is not None:  # None if the station was disarmed meanwhile, from its page or by REST
                    number, after = number + 1, run["id"]
                    report(describe_run(number, run))


def describe_run(number: int, run: dict[str, Any]) -> str:
    """Return one line of text that describes a run."""
    counts, timings, belt = run["counts"], run.get("timings"), run.get("belt")
    words = [f"board {number}: {run['verdict']}", f"{counts['ok']} of {run['rows'] * run['cameras']} frames"]
    if belt:
        words.append(f"belt {100 * (belt['ratio'] - 1):+.2f} %")
    if timings and "ready_after_last_frame_ms" in timings:
        words.append(f"matrices {timings['ready_after_last_frame_ms']:.0f} ms after the last frame")
    return ", ".join((*words, *(reason["message"] for reason in run["reasons"])))
