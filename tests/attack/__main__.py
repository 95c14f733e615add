"""Attack a running station that films boards on the twin: `python -m tests.attack [--seconds 30] [--nginx] [ATTACK …]`.

Prints one line per attack, with what an honest caller noticed of it, and the processor time that station and attacker
used. The attacks come from another process and from another address of loopback. With `--nginx`, both callers ask nginx
with the site of the package, which stands in front of the station.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

from tests.api.proxy.nginx import free_port, running, shipped_site
from tests.attack.attacker import attacked_by_process, processor_s
from tests.attack.attacks import ATTACKS, Target
from tests.attack.measuring import Experience, as_table, experience
from vaoi_station.config import read_config
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.waiting import poll, wait_until_idle
from vaoi_station.errors import DeviceError
from vaoi_station.files.access_keys import KEY_FILE, KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.simulation import find_scenario


def wait_for_workers(client: Client) -> None:
    """Wait until the station is idle, also on a machine that is so busy that compiling takes long."""
    for last in (False, False, True):
        try:
            wait_until_idle(client)
            break
        except DeviceError:
            if last:
                raise


def main() -> int:
    arguments = argparse.ArgumentParser(description="Attack a station on the twin.")
    arguments.add_argument("attacks", nargs="*", help=f"some of {', '.join(ATTACKS)} [all]")
    arguments.add_argument("--seconds", type=float, default=30.0, help="time of each attack")
    arguments.add_argument("--scenario", default="demo", help="scenario of the twin")
    arguments.add_argument("--nginx", action="store_true", help="with nginx in front of the station")
    given = arguments.parse_args()
    with tempfile.TemporaryDirectory(prefix="vaoi-attack-") as made:
        folder = Path(made)
        config, twin = write_station_files(find_scenario(given.scenario), folder)
        with Service(config, 0) as service, ExitStack() as parts:
            wait_for_workers(Client(service.address))
            station, port, keys = service.address, int(service.address.rpartition(":")[2]), ("", "")
            if given.nginx:
                file, front = KeyFile(read_config(config).data / KEY_FILE), free_port()
                first, second = (file.create(n, ["read", "operate", "teach"]).secret for n in ("honest", "attacker"))
                keys = (first, second)
                parts.enter_context(running(shipped_site(front, None), port, folder))
                port = front
            client = Client(f"http://127.0.0.1:{port}", CallerCredentials(key=keys[0] or None))
            client.post("/station/arm", board_type=twin.board_type.name)
            rows: list[tuple[str, Experience]] = []
            for name in ("nothing", *(given.attacks or ATTACKS)):
                run = poll(client, None)
                assert run is not None
                target = Target(port, run["id"], keys[1])
                with attacked_by_process(target, name) as attacker:
                    pids = [service.pid, *attacker]
                    begun, before = time.monotonic(), [processor_s(pid) for pid in pids]
                    noted = experience(client, given.seconds, station=station)
                    lasted_s = time.monotonic() - begun
                    noted.busy = [(processor_s(pid) - used) / lasted_s for pid, used in zip(pids, before, strict=True)]
                rows.append((name, noted))
                print(as_table(rows[-1:]).splitlines()[-1], rows[-1][1].refused[:2] or "", flush=True)
            print(as_table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
