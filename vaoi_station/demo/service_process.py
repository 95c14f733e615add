"""The process of the demo's service: `python -m vaoi_station.demo.service_process station.toml PORT`.

It runs the same service as `vaoi serve`. It imports everything first, and reads station.toml when its parent process
has sent a byte: the parent writes the file meanwhile. It also ends when its parent process ends: its standard input is
a pipe that the kernel then closes.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path


def main(config: str, port: str) -> int:
    """Wait for a byte from standard input, then serve until SIGTERM, or until standard input ends."""
    # Imported here: each child process of the station imports this module anew, but none of these.
    from vaoi_station.runs.host.processes import no_collections

    with no_collections():
        from vaoi_station.config import read_config
        from vaoi_station.errors import VaoiError
        from vaoi_station.runs.host.logs import configure_logging
        from vaoi_station.station import serve

    if not os.read(0, 1):
        return 0
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    configure_logging(as_json=False)
    try:
        serve(read_config(Path(config)), int(port), Path(config))
    except VaoiError as error:
        sys.stderr.write(f"{error}\n")
        return 3
    return 0


def _end_with_parent() -> None:
    """Send SIGTERM to this process when standard input ends."""
    # Read the file descriptor, not `sys.stdin`. Otherwise this thread would still hold the lock of `sys.stdin` when
    # the interpreter ends, and the interpreter would wait for that lock.
    while os.read(0, 1024):
        continue
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
