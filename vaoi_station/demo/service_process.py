"""The service's process: `python -m vaoi_station.demo.service_process station.toml PORT`.

The service as `vaoi serve` runs it, but that it ends when whoever started it is gone: its standard input
is a pipe that ends then.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path

from vaoi_station.config import read_config
from vaoi_station.errors import VaoiError
from vaoi_station.runs.host.logs import configure_logging
from vaoi_station.station import serve


def main(config: str, port: str) -> int:
    """Serve until SIGTERM, or until standard input ends."""
    threading.Thread(target=_end_with_the_other, name="lifeline", daemon=True).start()
    configure_logging(as_json=False)
    try:
        serve(read_config(Path(config)), int(port))
    except VaoiError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    return 0


def _end_with_the_other() -> None:
    """Reads of a file descriptor, not of `sys.stdin`, whose lock would be held when the interpreter ends."""
    while os.read(0, 1024):
        continue
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
