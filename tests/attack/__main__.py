"""Attack a running station that films boards on the twin: `python -m tests.attack [--seconds 30] [ATTACK …]`.

Prints one line per attack, with what an honest caller noticed of it, and the processor time that station and attacker
used. The attacks come from another process and from another address of loopback.
"""

from __future__ import annotations

import argparse
import sys
import time

from tests.attack.attacker import attacked_by_process, processor_s
from tests.attack.attacks import ATTACKS, Target
from tests.attack.measuring import Experience, as_table, experience
from vaoi_station.demo.client import Client
from vaoi_station.demo.service import Service
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.demo.temporary_folder import temporary_folder
from vaoi_station.demo.waiting import poll, wait_until_idle
from vaoi_station.errors import DeviceError
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
    given = arguments.parse_args()
    with temporary_folder("attack") as folder:
        config, twin = write_station_files(find_scenario(given.scenario), folder)
        with Service(config, 0) as service:
            client = Client(service.address)
            wait_for_workers(client)
            client.post("/station/arm", board_type=twin.board_type.name)
            rows: list[tuple[str, Experience]] = []
            for name in ("nothing", *(given.attacks or ATTACKS)):
                run = poll(client, None)
                assert run is not None
                target = Target(int(service.address.rpartition(":")[2]), run["id"])
                with attacked_by_process(target, name) as attacker:
                    pids = [service.pid, *attacker]
                    begun, before = time.monotonic(), [processor_s(pid) for pid in pids]
                    noted = experience(client, given.seconds)
                    lasted_s = time.monotonic() - begun
                    noted.busy = [(processor_s(pid) - used) / lasted_s for pid, used in zip(pids, before, strict=True)]
                rows.append((name, noted))
                print(as_table(rows[-1:]).splitlines()[-1], rows[-1][1].refused[:2] or "", flush=True)
            print(as_table(rows))
    return 0


if __name__ == "__main__":
    sys.exit(main())
