"""Compile the few inner loops that numpy and OpenCV cannot do in one pass (docs/decisions/0008)."""

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
"""Fast-math flags of LLVM: sums may be reordered, to run in vector registers; NaN and ∞ keep their meaning."""
_LOCK = "vaoi-station.lock"
"""File in the directory of the cached code."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code when it is first called.

    The code is cached on disk (in `NUMBA_CACHE_DIR`, else beside the module, else in the user's cache), so that only
    the first process after an installation waits for the compiler. The GIL is released while the code runs. Results are
    the same in all processes of one machine and may differ in the last digits between machines.

    A function with many arrays takes them in a `typing.NamedTuple`: Numba unpacks it in a microsecond or two.
    """
    try:
        made: Any = numba.njit(cache=True, nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    except RuntimeError:
        # Numba found no writable directory for its cache: every process compiles for itself
        return cast("Callable[P, R]", numba.njit(nogil=True, fastmath=_ALLOWED, error_model="numpy")(function))
    # Numba calls `compile` for each new combination of argument types
    made.compile = _alone(made.compile, Path(made.stats.cache_path))
    return cast("Callable[P, R]", made)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Inline a function into each compiled function of its module that calls it.

    A separate function would exist twice, optimised alone and with its caller. Which of the two is linked depends on
    whether the code was just compiled or cached, and so would the last digits of a result.
    """
    return cast(
        "Callable[P, R]", numba.njit(inline="always", nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    )


def _alone(compile_it: Callable[[Any], Any], cache: Path) -> Callable[[Any], Any]:
    """Return a compile function that only one process at a time runs; the others then find the code in the cache.

    If two processes compiled, each would run its own code. As other functions may be ready for inlining, the two may
    round differently, and a station's result would not be that of `vaoi stitch`.
    """

    def compile_alone(signature: Any) -> Any:
        with _lock(cache):
            return compile_it(signature)

    return compile_alone


_in_this_process = threading.RLock()
_depth = 0


@contextmanager
def _lock(directory: Path) -> Iterator[None]:
    """Hold the lock of a directory; functions that are compiled within hold it too."""
    global _depth  # noqa: PLW0603  (one per process, changed under its lock)
    # threads first take a lock of the process, which a thread may hold twice; flock cannot be held twice
    with _in_this_process:
        # a compiled function compiles those that it calls: a second flock on another open file would be a deadlock
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
