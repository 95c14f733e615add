"""Soak the acquisition process alone, as fast as its replay plays: `python -m tests.soak.alone.acquisition`.

Prints the private memory and the number of objects of Python over the boards, and what the allocator gives back at the
end. Growth that ends, without more objects, is the allocator's; growth that goes on is a leak.
"""

from __future__ import annotations

import argparse
import multiprocessing
import tempfile
import threading
from pathlib import Path

from tests.soak.alone.memory import objects, private_mb, trimmed_mb
from tests.soak.line_files import Pace, write_line_files
from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.process.main_loop import run_acquisition
from vaoi_station.acquisition.process.messages import Arm, Grant, Ready, RunFinished, Shutdown
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.config import read_config


def main() -> None:
    """Let boards pass, and print what they leave behind."""
    parser = argparse.ArgumentParser(prog="python -m tests.soak.alone.acquisition", description=__doc__)
    parser.add_argument("--boards", type=int, default=20_000)
    parser.add_argument("--every", type=int, default=2000, help="number of boards between two lines")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="vaoi-soak-") as folder:
        config = read_config(write_line_files(Path(folder), Path(folder) / "data", Pace(0.0)))
        assert config.replay is not None
        replay = config.replay.model_copy(update={"pace": "fast", "pause_s": 0.0})
        config = config.model_copy(update={"replay": replay})
        here, there = multiprocessing.Pipe()
        with Ring.create(ring_path(config), RingLayout.of(config)) as ring:
            arguments = (config, ring_path(config), there)
            thread = threading.Thread(target=run_acquisition, args=arguments, name="acquisition", daemon=True)
            thread.start()
            done = 0
            while done < chosen.boards:
                report = here.recv()
                if isinstance(report, Ready):
                    for bay in range(ring.layout.bays):
                        ring.claim(bay)
                        here.send(Grant(f"first-{bay}", bay))
                    here.send(Arm(filming_plan(config)))
                elif isinstance(report, RunFinished):
                    done += 1
                    ring.claim(report.bay)
                    here.send(Grant(f"{done:06d}", report.bay))
                    if done % chosen.every == 0:
                        print(f"{done} boards: {private_mb():.3f} MB, {objects()} objects", flush=True)
            before = private_mb()
            print(f"malloc_trim gives back {before - trimmed_mb():.2f} MB")
            here.send(Shutdown())
            while thread.is_alive():
                if here.poll(0.1):
                    try:
                        here.recv()
                    except EOFError:
                        break
            thread.join()


if __name__ == "__main__":
    main()
