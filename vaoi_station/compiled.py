"""Compile to machine code the inner loops that numpy and OpenCV cannot perform in one pass (docs/decisions/0008)."""

from __future__ import annotations

import fcntl
import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_ALLOWED = {"reassoc", "contract", "arcp", "nsz"}
"""Fast-math flags of LLVM that the compiler may use.

They allow it to reorder sums, so that sums run in vector registers. NaN and ∞ keep their meaning."""
_functions: list[Any] = []
"""The compiled functions of all modules that were imported."""
_LOCK = "vaoi-station.lock"
"""Name of the lock file, in the directory where Numba caches the machine code."""
_before_compiling: list[Callable[[], object]] = []
"""What this process calls before it compiles for the first time."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code when it is first called; the GIL is then released.

    The code is cached on disk (in `NUMBA_CACHE_DIR`, else beside the module, else in the user's cache). Values are the
    same in all processes of one machine and may differ in the last digits between machines. A function of many arrays
    takes them as fields of a `typing.NamedTuple`.
    """
    try:
        made: Any = numba.njit(cache=True, nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    except RuntimeError:
        # Numba found no writable directory for its cache: every process compiles for itself
        return cast("Callable[P, R]", numba.njit(nogil=True, fastmath=_ALLOWED, error_model="numpy")(function))
    # Numba calls `compile` for each new combination of argument types
    made.compile = _alone(made)
    _functions.append(made)
    return cast("Callable[P, R]", made)


def progress() -> tuple[int, int]:
    """Return how many functions this process has compiled or loaded from the cache, and how many there are."""
    return sum(bool(made.signatures) for made in _functions), len(_functions)


@contextmanager
def when_compiling(act: Callable[[], object]) -> Iterator[None]:
    """Call `act` in the context once, before this process compiles a function that is not in the cache."""
    _before_compiling.append(act)
    try:
        yield
    finally:
        if act in _before_compiling:
            _before_compiling.remove(act)


def signatures() -> set[tuple[str, str]]:
    """Return the name of each compiled function and types of arguments for which this process has its machine code."""
    return {
        (f"{made.py_func.__module__}.{made.py_func.__name__}", str(s)) for made in _functions for s in made.signatures
    }


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Inline a function into each compiled function of its module that calls it.

    Its machine code would else exist twice, alone and within its caller. The two may round differently, so that the
    last digits of a result would depend on which of them the cache has.
    """
    return cast(
        "Callable[P, R]", numba.njit(inline="always", nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    )


def _alone(made: Any) -> Callable[[Any], Any]:
    """Return `made.compile` with a lock: one process at a time compiles, the others wait and then load the cached code.

    Two processes that compiled the same function could round differently, because not the same other functions are
    ready for inlining: the result of a station would differ from that of `vaoi stitch`.
    """
    compile_it, load, cache = made.compile, made._cache.load_overload, Path(made.stats.cache_path)

    def compile_alone(signature: Any) -> Any:
        with _in_this_process, _without_collections(), ExitStack() as compiling:

            def load_or_lock(*request: Any) -> Any:
                with _lock(cache, fcntl.LOCK_SH):
                    found = load(*request)
                if found is None:
                    compiling.enter_context(_lock(cache, fcntl.LOCK_EX))
                    # Another process may have compiled it between the two locks.
                    found = load(*request)
                if found is None and _before_compiling:
                    _before_compiling.pop()()
                return found

            made._cache.load_overload = load_or_lock
            return compile_it(signature)

    return compile_alone


@contextmanager
def _without_collections() -> Iterator[None]:
    """Turn automatic collections off: the compiler makes many objects that last, and a tenth of its time went there."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_in_this_process = threading.RLock()
_depth = 0


@contextmanager
def _lock(directory: Path, how: int) -> Iterator[None]:
    """Exclude other processes from a cache directory: all (`LOCK_EX`), or those that compile into it (`LOCK_SH`).

    The lock is re-entrant, because compiling a function also loads or compiles those it calls.
    """
    global _depth  # noqa: PLW0603  (one per process, changed under its lock)
    # an RLock excludes the other threads of this process; one thread may take it twice, which flock does not allow
    with _in_this_process:
        # nested call: this thread holds the file lock already, and a second flock on another open file would block
        if _depth:
            yield
            return
        directory.mkdir(parents=True, exist_ok=True)
        with (directory / _LOCK).open("w") as file:
            fcntl.flock(file, how)
            _depth += 1
            try:
                yield
            finally:
                _depth -= 1
