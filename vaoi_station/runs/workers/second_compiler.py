"""The second process of a first start: it compiles while the first one warms up (`python -m`, with this module).

Numba compiles under the GIL, so that threads would not share the work. Both processes store the machine code in the
same cache, and each waits for what the other one compiles (`vaoi_station.compiled`). The first process begins with the
links of the synthetic board, the second one with its marks. When both have all that the first board needs, the station
is ready, and the second process goes on with what is computed after the pictures of a board: jobs for it wait until
then (`later_code_is_there`), because a worker that compiles could not link the next board. A second process that fails
costs nothing but time: who needs the code compiles it.
"""

from __future__ import annotations

import logging
import os
import select
import subprocess
import sys
import threading
from contextlib import suppress

from vaoi_station.child_environment import child_environment
from vaoi_station.compiled import cache_directory, when_compiling

_log = logging.getLogger(__name__)
ORPHANED = 1
"""Exit code of the second process if the first one has ended."""
LESS_URGENT = 10
"""By how much the second process is less urgent than others (`nice`) while boards may come."""
_COMMAND = [sys.executable, "-P", "-m", "vaoi_station.runs.workers.second_compiler"]
_pidfd: int | None = None
"""Stands for the second process, also in workers, which are forked while it compiles; None: there is none."""


class _NotCompiledError(Exception):
    """Code is not in the cache: another process is to compile it."""


class SecondCompiler:
    """The second process, which is started when this process has to compile. `close` ends it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def warm_up(self) -> None:
        """Load or compile what the first board needs. Load the rest, or leave it to the second process."""
        from vaoi_station.runs.workers import warmup

        with when_compiling(self._start):
            warmup.warm_up()
        if self._process is None:
            with suppress(_NotCompiledError), when_compiling(self._leave):
                warmup.warm_up_later()

    def wait(self) -> None:
        """Wait until the second process has compiled everything."""
        if self._process is not None:
            self._process.wait()

    def note_end(self) -> None:
        """Release what the kernel keeps of a second process that has ended, and report one that has failed."""
        if (process := self._process) is not None and process.returncode is None and process.poll():
            _log.warning("the second process that compiles has ended with exit code %d", process.returncode)

    def close(self) -> None:
        """End the second process."""
        self.note_end()
        if self._process is not None:
            self._process.kill()
            self._process.communicate()

    def _start(self) -> None:
        global _pidfd  # noqa: PLW0603  workers inherit it
        if cache_directory() is None:
            return  # nothing can be handed over
        try:
            # The pipe is closed by the kernel if this process is killed, which ends the second one.
            self._process = subprocess.Popen(_COMMAND, stdin=subprocess.PIPE, env=child_environment())
            _pidfd = os.pidfd_open(self._process.pid)
        except OSError as fault:
            _log.warning("no second process compiles: %s", fault)

    def _leave(self) -> None:
        self._start()
        if self._process is not None:
            raise _NotCompiledError


def later_code_is_there() -> bool:
    """Return whether what is computed after the pictures of a board is compiled, or no other process compiles it."""
    if _pidfd is None:
        return True
    poll = select.poll()
    poll.register(_pidfd, select.POLLIN)
    return bool(poll.poll(0))


def compile_all() -> None:
    """Compile all that is not in the cache yet, in two processes."""
    second = SecondCompiler()
    try:
        second.warm_up()
        second.wait()
    finally:
        second.close()


def _end_with_parent() -> None:
    while os.read(0, 1024):
        continue
    os._exit(ORPHANED)


def main() -> None:
    """Be the second process: compile what the first one needs last, and then what comes after the first pictures."""
    threading.Thread(target=_end_with_parent, name="parent watch", daemon=True).start()
    from vaoi_station.runs.workers.warmup import warm_up_from_the_end, warm_up_later

    warm_up_from_the_end()
    os.nice(LESS_URGENT)
    warm_up_later()


if __name__ == "__main__":
    main()
