"""A whole station reports a board by IPC-CFX, from the start to the stop; without the library it does not start."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from tests.push.amqp_broker import Broker, need_proton
from tests.push.test_publisher import until
from tests.system.conftest import film_one, until_state
from vaoi_station.config import StationConfig
from vaoi_station.station import Station


def names_of(broker: Broker) -> list[str]:
    return [document["MessageName"].rpartition(".")[2] for document in broker.documents(0)]


def test_a_station_reports_a_board_from_start_to_stop(replay_config: Callable[..., StationConfig]) -> None:
    need_proton()
    broker = Broker()
    broker.start()
    made = replay_config()
    cfx = {"host": "127.0.0.1", "port": broker.port, "address": "cfx", "handle": "Vendor.Model.Serial"}
    config = StationConfig.model_validate({**made.model_dump(), "push": {"cfx": cfx}})
    try:
        with Station(config) as station:
            until_state(station.coordinator, "idle")
            run = film_one(station.coordinator)
            until(lambda: "UnitsInspected" in names_of(broker))
    finally:
        broker.stop()
    documents, names = broker.documents(0), names_of(broker)
    for name in ("StationOnline", "StationOffline", "EndpointShuttingDown"):
        assert names.count(name) == 1, names
    work = [d for d in documents if d["MessageName"].startswith("CFX.Production")]
    order = ["RecipeActivated", "UnitsArrived", "WorkStarted", "UnitsDeparted", "WorkCompleted", "UnitsInspected"]
    assert [d["MessageName"].rpartition(".")[2] for d in work][:6] == order
    recipe, arrived, started, _, completed, inspected = (d["MessageBody"] for d in work[:6])
    assert recipe["RecipeName"] == run.board_type
    assert arrived["PrimaryIdentifier"] == run.board_id or arrived["PrimaryIdentifier"] == f"run:{run.id}"
    assert completed["TransactionID"] == started["TransactionID"] == inspected["TransactionId"]
    (inspection,) = inspected["InspectedUnits"][0]["Inspections"]
    measured = {one["MeasurementName"]: one["MeasuredValue"]["Value"] for one in inspection["Measurements"]}
    assert 0 < measured["sigma_px"] < 1
    states = [d["MessageBody"]["NewState"] for d in documents if d["MessageName"].endswith("StateChanged")]
    assert states[0] == "2000"
    assert "1100" in states
    assert states[-1] == "6500"


def test_without_the_library_the_station_says_what_to_install(tmp_path: Path) -> None:
    code = f"""
import importlib.util, pathlib, sys
from vaoi_station.push import proton_library
from vaoi_station.errors import DeviceError
sys.path = [path for path in sys.path if not (pathlib.Path(path) / "proton").is_dir()]
proton_library.SYSTEM_PACKAGES = pathlib.Path({str(tmp_path)!r})
try:
    proton_library.load()
except DeviceError as error:
    print(error.code, error.message, error.action)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("cfx-package-absent push.cfx is set, but Qpid Proton cannot be used: ")
    assert "apt install python3-qpid-proton" in done.stdout
