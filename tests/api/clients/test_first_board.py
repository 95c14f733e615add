"""The guide "Your own board in five minutes", as it is printed, with the data of a real product."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2

from tests.needs import FILMS, need, need_films
from vaoi_station.cli.demo import demo
from vaoi_station.demo.client import Client
from vaoi_station.demo.given_board import write_given_scenario
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.waiting import wait_until_idle

GUIDE = Path(__file__).parents[3] / "docs" / "first-board.md"
PRODUCT = FILMS / "boards" / "orangecrab"


def test_the_guide_leads_from_cad_files_to_pictures(tmp_path: Path) -> None:
    need_films()
    need("curl")
    blocks = re.findall(r"^```sh\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    make, film, *fetch = blocks
    for ours, theirs in (("product.kicad_pcb", "orangecrab.kicad_pcb"), ("product.odb.zip", "orangecrab.odb.zip")):
        (tmp_path / ours).symlink_to(PRODUCT / theirs)
    made = subprocess.run(
        [sys.executable, "-m", *make.replace("vaoi", "vaoi_station", 1).split()], cwd=tmp_path, timeout=200, check=False
    )
    assert made.returncode == 0
    # The demo is started as `film` does it, but at a free port, and armed by the test.
    assert film.split() == ["vaoi", demo.__name__, "--board", "board.json"]
    scenario = write_given_scenario(tmp_path / "board.json", "demo", tmp_path)
    config, twin = write_station_files(scenario, tmp_path / "station")
    with Service(config) as service:
        client = Client(service.address)
        wait_until_idle(client)
        client.post("/station/arm", board_type=twin.board_type.name)
        done = subprocess.run(
            ["sh", "-eu", "-c", "".join(fetch)],
            cwd=tmp_path,
            env=os.environ | {"VAOI_STATION": service.address},
            capture_output=True,
            text=True,
            timeout=200,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        ended = [run for run in client.get("/runs")["runs"] if run.get("verdict")]
    assert {run["board_type"] for run in ended} == {twin.board_type.name, "from-odb"}
    assert {run["verdict"] for run in ended} == {"ok"}, ended
    pictures = [cv2.imread(str(tmp_path / name)) for name in ("U1.png", "U1-odb.png")]
    assert all(picture is not None and picture.size > 1000 for picture in pictures)
    assert (tmp_path / "U1.zip").read_bytes().startswith(b"PK")
    assert (tmp_path / "preview.svg").read_text(encoding="utf-8").startswith("<svg")
