"""Compile to machine code the inner loops that numpy and OpenCV cannot perform in one pass (docs/decisions/0008)."""

from __future__ import annotations

import fcntl
import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial, update_wrapper
from pathlib import Path
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")

_ALLOWED = {"reassoc", "contract", "arcp", "nsz"}
"""Fast-math flags of LLVM that the compiler may use.

They allow it to reorder sums, so that sums run in vector registers. NaN and ∞ keep their meaning."""
_functions: list[_Deferred] = []
"""The compiled functions of all modules that were imported."""
_in_this_process = threading.RLock()
_before_compiling: list[Callable[[], object]] = []
"""What this process calls before it compiles for the first time."""


class _Deferred:
    """A function that Numba takes over when it is first called: a process that calls none does not load Numba."""

    def __init__(self, function: Callable[..., Any], make: Callable[[Callable[..., Any]], Any]) -> None:
        update_wrapper(self, function)
        self._function, self._make = function, make
        self._dispatcher: Any = None
        self.made: Any = None
        """What Numba has made of the function; None before the first call."""

    def __call__(self, *values: Any) -> Any:
        return (self.made or self._resolved())(*values)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._resolved(), name)

    def _resolved(self) -> Any:
        with _in_this_process:
            if self._dispatcher is None:
                self._dispatcher = self._make(self._function)
                # Numba looks up what the function calls among the globals of its module.
                names = self._function.__globals__
                for name, value in [*names.items()]:
                    if isinstance(value, _Deferred):
                        names[name] = value._resolved()
                self.made = self._dispatcher
            return self._dispatcher


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code when it is first called; the GIL is then released.

    The code is cached on disk (in `NUMBA_CACHE_DIR`, else beside the module, else in the user's cache). Values are the
    same in all processes of one machine and may differ in the last digits between machines. A function of many arrays
    takes them as fields of a `typing.NamedTuple`.
    """
    deferred = _Deferred(function, _cached)
    _functions.append(deferred)
    return cast("Callable[P, R]", deferred)


def inlined(function: Callable[P, R]) -> Callable[P, R]:
    """Inline a function into each compiled function of its module that calls it.

    Its machine code would else exist twice, alone and within its caller. The two may round differently, so that the
    last digits of a result would depend on which of them the cache has.
    """
    return cast("Callable[P, R]", _Deferred(function, partial(_jit, inline="always")))


def _prefetch_intrinsic(_: Callable[..., Any]) -> Any:
    from llvmlite import ir  # type: ignore[import-untyped]
    from numba import types
    from numba.extending import intrinsic

    def prefetch(_context: Any, address: Any) -> Any:  # noqa: ARG001  (Numba takes the names of arguments)
        def generate(_compiler: Any, builder: Any, _signature: Any, arguments: Any) -> None:
            byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
            form = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
            instruction = builder.module.declare_intrinsic("llvm.prefetch", [byte], form)
            # of data, to read them, into all levels of the cache
            builder.call(instruction, [builder.inttoptr(arguments[0], byte), number(0), number(3), number(1)])

        return types.void(types.uintp), generate

    return intrinsic(prefetch)


def _prefetch(address: int) -> None:
    """Let the processor read the cache line at an address (`array.ctypes.data`) while compiled code computes."""


prefetch = cast("Callable[[int], None]", _Deferred(_prefetch, _prefetch_intrinsic))


def _jit(function: Callable[..., Any], **options: Any) -> Any:
    import numba

    return numba.njit(function, nogil=True, fastmath=_ALLOWED, error_model="numpy", **options)


def _cached(function: Callable[..., Any]) -> Any:
    try:
        made = _jit(function, cache=True)
    except RuntimeError:
        # Numba found no writable directory for its cache: every process compiles for itself
        return _jit(function)
    # Numba calls `compile` for each new combination of argument types
    made.compile = _alone(made)
    return made


def progress() -> tuple[int, int]:
    """Return how many functions this process has compiled or loaded from the cache, and how many there are."""
    return sum(bool(f.made and f.made.signatures) for f in _functions), len(_functions)


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
    made = [f.made for f in _functions if f.made is not None]
    return {(f"{m.py_func.__module__}.{m.py_func.__name__}", str(s)) for m in made for s in m.signatures}


def _alone(made: Any) -> Callable[[Any], Any]:
    """Return `made.compile` with a lock: one process compiles a function, the others wait and then load its code.

    Two processes that compiled the same function could round differently, because not the same other functions are
    ready for inlining: the result of a station would differ from that of `vaoi stitch`.
    """
    compile_it, load, function = made.compile, made._cache.load_overload, made.py_func
    file = Path(made.stats.cache_path) / f"{function.__module__}.{function.__qualname__}.lock"

    def compile_alone(signature: Any) -> Any:
        with _in_this_process, _without_collections(), ExitStack() as compiling:

            def load_or_lock(*request: Any) -> Any:
                with _lock(file, fcntl.LOCK_SH):
                    found = load(*request)
                if found is None:
                    compiling.enter_context(_lock(file, fcntl.LOCK_EX))
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


_held: set[Path] = set()
"""The lock files that this process holds."""


@contextmanager
def _lock(path: Path, how: int) -> Iterator[None]:
    """Exclude other processes from the code of a function: all (`LOCK_EX`), or the one that compiles it (`LOCK_SH`).

    Compiling a function also loads or compiles those that it calls, never one that calls it: no two processes wait for
    each other.
    """
    # an RLock excludes the other threads of this process; one thread may take it twice, which flock does not allow
    with _in_this_process:
        # a second flock on another open file would block
        if path in _held:
            yield
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w") as file:
            fcntl.flock(file, how)
            _held.add(path)
            try:
                yield
            finally:
                _held.remove(path)
