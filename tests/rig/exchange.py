"""Exchange a camera of a running station on the virtual rig, end to end; prints what was seen as JSON.

    python -m tests.rig.exchange FOLDER

It runs in a network namespace of its own. A board passes; camera 1 loses its power, and another one of the same model
hangs in its place, turned by some tenths of a degree; it takes the place, boards pass, its calibration is confirmed,
and a last board passes.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from tests.drift.conftest import SCENARIO
from vaoi_station.config import read_config
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.waiting import wait_for_run, wait_until_idle
from vaoi_station.files.access_keys import KEY_FILE, KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.rig.devices import Devices, build_site
from vaoi_station.rig.line import BoardFeeder, min_interval_s
from vaoi_station.rig.network import LoopbackAddresses
from vaoi_station.rig.rendering import RenderedBoard, render_boards
from vaoi_station.simulation import Scenario

NEW, ADDRESS = "VAOI-99", "127.0.0.40"
KNOCKS = [
    {"camera": 1, "about": about, "angle_deg": angle, "from_board": 1}
    for about, angle in (("x", -0.4), ("y", 0.3), ("z", -0.4))
]
T = TypeVar("T")
PATIENCE_S = 60.0
MOST_PASSAGES = 3
"""How often the second board passes at most, until it shows enough of the new camera."""


class Exchange:
    """The steps of the technician, over the REST addresses that the page uses."""

    def __init__(self, client: Client, devices: Devices, interval_s: float) -> None:
        self._client, self._devices, self._interval_s = client, devices, interval_s

    def film(self, board: RenderedBoard) -> dict[str, Any]:
        """Arm for one board, let it pass, and return its run."""
        self._client.post("/station/arm", board_type=board.board_type.name, runs=1)
        before = self._client.get("/runs", limit=1)["runs"]
        with BoardFeeder(self._devices.line, [board], self._interval_s) as feeder:
            feeder.finished.wait(60)
        return wait_for_run(self._client, before[0]["id"] if before else None)

    def until(self, seen: Callable[[], T | None]) -> T:
        """Return what `seen` returns once it is not None; each event of the station, heartbeats too, is a new try."""
        deadline_s = time.monotonic() + PATIENCE_S
        for _ in self._client.messages():
            if (found := seen()) is not None:
                return found
            assert time.monotonic() < deadline_s, self._client.get("/station")
        raise AssertionError("the station has ended")

    def connected(self, camera: int, wanted: bool = True) -> dict[str, Any]:
        """Wait until a camera is connected, or lost; return its status."""

        def found() -> dict[str, Any] | None:
            status: dict[str, Any] = self._client.get("/station")["cameras"][camera]
            return status if status["connected"] is wanted else None

        return self.until(found)

    def processes(self) -> dict[str, Any]:
        """Return the ids of the processes of the station by their names."""
        return {process["name"]: process["pid"] for process in self._client.get("/station")["processes"]}

    def estimate(self, camera: int) -> dict[str, Any]:
        """Return what boards show of an exchanged camera, once the latest board was checked."""
        exchange: dict[str, Any] = self._client.get("/calibration")["cameras"][camera].get("exchange", {})
        return exchange


def main(folder: Path) -> dict[str, Any]:
    scenario = Scenario.model_validate({**SCENARIO, "faults": {"knocked": KNOCKS}})
    boards = render_boards(scenario, range(3), folder / "films", lambda _: None)
    with LoopbackAddresses([ADDRESS]), Devices(scenario, folder) as devices:
        config = build_site(
            scenario, boards[0], folder, name="exchange", addresses=devices.addresses, port=devices.terminal, workers=1
        )
        secret = KeyFile(read_config(config).data / KEY_FILE).create("technician", ["admin", "operate"]).secret
        with Service(config) as service:
            client = Client(service.address, CallerCredentials(secret))
            wait_until_idle(client)
            rig = Exchange(client, devices, min_interval_s(scenario, boards))
            seen: dict[str, Any] = {"before": rig.film(boards[0])["verdict"], "processes": [rig.processes()]}
            devices.exchange_camera(1, ADDRESS, NEW)
            rig.connected(1, wanted=False)
            seen["gone"] = client.get("/cameras/search")["gone"]
            began_s = time.monotonic()
            seen["exchange"] = client.post("/cameras/1/exchange", serial=NEW)
            seen["status"] = rig.connected(1)
            seen["opened_s"] = round(time.monotonic() - began_s, 1)
            seen["runs"] = []
            for _ in range(MOST_PASSAGES):
                run = rig.film(boards[1])
                seen["runs"].append({"verdict": run["verdict"], "causes": [r.get("cause") for r in run["reasons"]]})
                rig.until(lambda: rig.estimate(1).get("boards") == len(seen["runs"]) or None)
                if rig.estimate(1).get("ready"):
                    break
            seen["estimate"] = rig.estimate(1)
            seen["confirmed"] = client.post("/cameras/1/exchange/confirm")
            seen["took_s"] = round(time.monotonic() - began_s, 1)
            last = rig.film(boards[2])
            seen["after"] = {key: last.get(key) for key in ("verdict", "reasons", "counts")}
            seen["processes"].append(rig.processes())
            seen["warnings"] = [warning["code"] for warning in client.get("/station")["warnings"]]
            seen["settings"] = config.read_text()
    return seen


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]).resolve()), default=str))
