"""Compilation of the few inner loops that numpy and OpenCV cannot do in one pass (docs/decisions/0008)."""

from __future__ import annotations

import fcntl
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_ALLOWED = {"reassoc", "contract", "arcp", "nsz"}
"""Liberties of the compiler: sums may be reordered, to run in vector registers; NaN and ∞ keep their meaning."""
_LOCK = "vaoi-station.lock"


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code when it is first called.

    The code is kept on disk (in `NUMBA_CACHE_DIR`, else beside the module, else in the user's cache), so that only the
    first process after an installation waits for the compiler. The GIL is released while it runs. Results are
    the same in all processes of one machine and may differ in the last digits between machines.
    """
    try:
        made: Any = numba.njit(cache=True, nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    except RuntimeError:  # no place on this machine where code may be kept: every process compiles for itself
        return cast("Callable[P, R]", numba.njit(nogil=True, fastmath=_ALLOWED, error_model="numpy")(function))
    made.compile = _alone(made.compile, Path(made.stats.cache_path))
    return cast("Callable[P, R]", made)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """The same for a function that compiled functions of its module call: it becomes a part of each of them.

    A function that stayed one of its own would be there twice, optimised alone and with its caller; which of the two is
    linked depends on whether the code was just compiled or kept, and so would the last digits of a result.
    """
    return cast(
        "Callable[P, R]", numba.njit(inline="always", nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    )


def _alone(compile_it: Callable[[Any], Any], kept_in: Path) -> Callable[[Any], Any]:
    """Compile while no other process does: it finds the code when its turn comes.

    Were both to compile, each would run its own code; compiled at different times, with other functions at hand to be
    inlined, the two may round differently, and a station's result would not be that of `vaoi stitch`.
    """

    def compile_alone(signature: Any) -> Any:
        with _turn(kept_in):
            return compile_it(signature)

    return compile_alone


_in_this_process = threading.RLock()
_depth = 0


@contextmanager
def _turn(directory: Path) -> Iterator[None]:
    """Hold the lock of a directory; functions that are compiled on the way belong to the same turn."""
    global _depth  # noqa: PLW0603  (of this process, under its lock)
    with _in_this_process:
        if _depth:
            yield
            return
        directory.mkdir(parents=True, exist_ok=True)
        with (directory / _LOCK).open("w") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            _depth += 1
            try:
                yield
            finally:
                _depth -= 1
