"""The second process of a first start: it compiles while the first one warms up (`python -m`, with this module).

Numba compiles under the GIL, so that threads would not share the work. Both processes store the machine code in the
same cache, and each waits for what the other one compiles (`vaoi_station.compiled`). The first process stitches the
synthetic board, and then needs the functions for pictures and heights, which the second one has compiled meanwhile. It
compiles itself what it does not find. So a second process that fails costs nothing but time.
"""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from vaoi_station.child_environment import child_environment
from vaoi_station.compiled import when_compiling

_log = logging.getLogger(__name__)
ORPHANED = 1
"""Exit code of the second process if the first one has ended."""
_COMMAND = [sys.executable, "-m", "vaoi_station.runs.workers.second_compiler"]


@contextmanager
def second_compiler() -> Iterator[None]:
    """Start the second process when this process begins to compile in the context; it ends with the context.

    It is not started if all machine code is in the cache, or if this process has only one core.
    """
    started: list[subprocess.Popen[bytes]] = []

    def start() -> None:
        if len(os.sched_getaffinity(0)) > 1:
            try:
                # The pipe is closed by the kernel if this process is killed, which ends the second one.
                started.append(subprocess.Popen(_COMMAND, stdin=subprocess.PIPE, env=child_environment()))
            except OSError as fault:
                _log.warning("no second process compiles: %s", fault)

    with when_compiling(start):
        try:
            yield
        finally:
            for process in started:
                if process.poll():
                    _log.warning("the second process that compiles has ended with exit code %d", process.returncode)
                process.kill()
                process.communicate()


def compile_all() -> None:
    """Compile all that is not in the cache yet, in two processes."""
    from vaoi_station.runs.workers.warmup import warm_up

    with second_compiler():
        warm_up()


def _end_with_parent() -> None:
    while os.read(0, 1024):
        continue
    os._exit(ORPHANED)


def main() -> None:
    """Be the second process: compile what the warm-up of the first one needs last."""
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    from vaoi_station.runs.workers.warmup import warm_up_from_the_end

    warm_up_from_the_end()


if __name__ == "__main__":
    main()
