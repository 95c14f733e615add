"""Compile to machine code the inner loops that numpy and OpenCV cannot perform in one pass (docs/decisions/0008)."""

from __future__ import annotations

import fcntl
import gc
import hashlib
import os
import pickle
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, partial, update_wrapper
from pathlib import Path
from types import CodeType
from typing import Any, ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")

_ALLOWED = {"reassoc", "contract", "arcp", "nsz"}
"""Fast-math flags of LLVM that the compiler may use.

They allow it to reorder sums, so that sums run in vector registers. NaN and ∞ keep their meaning."""
_PACKAGE = Path(__file__).parent
SHIPPED = _PACKAGE / "machine_code"
"""Machine code that a package brings along (`deploy/build`); the directory does not exist in a checkout."""
_SHIPPED_FOR = "x86-64-v3"
"""The processor for which it is made. Where nothing is shipped, code is made for the processor at hand, and links are
found in 4 % less time."""
_SHIPPED_NEEDS = ("avx", "avx2", "bmi", "bmi2", "cx16", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2", "xsave")
_UNUSED_S = 30 * 86400
"""Code that no process has loaded for so long goes when its function is compiled anew, as after an update."""
_DIGEST_BYTES = 32
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

    The code is kept on disk (`cache_directory`), by the content of the function and of all that it calls. Values are
    the same in all processes of one machine and may differ in the last digits between machines. A function of many
    arrays takes them as fields of a `typing.NamedTuple`.
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
    numba = _numba()
    return numba.njit(function, nogil=True, fastmath=_ALLOWED, error_model="numpy", **options)


@cache
def _numba() -> Any:
    import numba
    from llvmlite import binding

    config: Any = numba.config
    if SHIPPED.is_dir() and config.CPU_NAME is None:
        features = binding.get_host_cpu_features()
        if all(features.get(name) for name in _SHIPPED_NEEDS):
            # the name stands for its features
            config.CPU_NAME, config.CPU_FEATURES = _SHIPPED_FOR, ""
    return numba


def _cached(function: Callable[..., Any]) -> Any:
    made = _jit(function)
    if not Path(function.__code__.co_filename).is_file():
        return made
    made._cache = _KeptCode(function)
    # Numba calls `compile` for each new combination of argument types
    made.compile = _alone(made)
    return made


@cache
def cache_directory() -> Path | None:
    """Return where this process stores machine code; None if it can write to none of `cache_directories`."""
    for directory in cache_directories():
        with suppress(OSError):
            directory.mkdir(parents=True, exist_ok=True)
            if os.access(directory, os.W_OK | os.X_OK):
                return directory
    return None


def cache_directories() -> tuple[Path, ...]:
    """Return the directories for machine code in the order of preference."""
    if given := os.environ.get("NUMBA_CACHE_DIR"):
        return (Path(given),)
    users = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return _PACKAGE / "__pycache__" / "machine_code", users / "vaoi-station"


def read_kept(file: Path) -> bytes | None:
    """Return what `write_kept` has written to a file; None if it does not exist, or a power cut left it incomplete."""
    with suppress(OSError):
        # This fails if the file is not there, or belongs to a user who permits no other one to read it.
        content = file.read_bytes()
        if hashlib.sha256(content[:-_DIGEST_BYTES]).digest() == content[-_DIGEST_BYTES:]:
            with suppress(OSError):  # shipped code cannot be written to
                os.utime(file)  # it is in use
            return content[:-_DIGEST_BYTES]
    return None


def write_kept(file: Path, content: bytes) -> None:
    """Write a file with its digest; a disk that is full or broken costs nothing but the time to make it again."""
    new = file.with_suffix(f".{os.getpid()}")
    with suppress(OSError):
        try:
            new.write_bytes(content + hashlib.sha256(content).digest())
            new.replace(file)
        finally:
            new.unlink(missing_ok=True)


class _KeptCode:
    """The machine code of one function on disk, a file for each combination of argument types.

    It takes the place of Numba's cache, whose key is one source file: a function changes, too, with a helper or a
    constant of another module, and does not change with the rest of its own. The key is all that the code depends on.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        import llvmlite
        import numba

        self._name = f"{function.__module__}.{function.__qualname__}"
        versions = (numba.__version__, llvmlite.__version__, sys.version_info[:2], sorted(_ALLOWED))
        self._content = "\n".join((repr(versions), *_content(function, set())))
        self.cache_path = str(cache_directory())
        self.lock = None if cache_directory() is None else Path(self.cache_path) / f"{self._name}.lock"

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the code for a signature; None if there is none."""
        from numba.core import compiler

        result: Any = compiler.CompileResult
        context.refresh()
        name = self._file(signature, context.codegen())
        for directory in (SHIPPED, cache_directory()):
            if directory is not None and (content := read_kept(directory / name)) is not None:
                return result._rebuild(context, *pickle.loads(content))
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Store code; a disk that is full or broken costs nothing but the time to compile again."""
        from numba.core import serialize

        dumps: Any = serialize.dumps
        if (directory := cache_directory()) is None:
            return
        write_kept(directory / self._file(signature, result.codegen), dumps(result._reduce()))
        with suppress(OSError):
            for old in directory.glob(f"{self._name}-*.nbc"):
                if time.time() - old.stat().st_mtime > _UNUSED_S:
                    old.unlink()

    def _file(self, signature: Any, codegen: Any) -> str:
        kinds = getattr(signature, "args", signature)
        fields = [getattr(kind, "fields", ()) for kind in kinds]
        key = repr((self._content, str(kinds), fields, codegen.magic_tuple()))
        return f"{self._name}-{hashlib.sha256(key.encode()).hexdigest()[:20]}.nbc"


def _content(function: Callable[..., Any], seen: set[int]) -> Iterator[str]:
    """Yield all that the machine code of a function is made of: its own code, what it calls, and constants."""
    if id(function) in seen:
        return
    seen.add(id(function))
    names = function.__globals__
    yield f"{function.__module__}.{function.__qualname__} {function.__defaults__!r}"
    codes = [function.__code__]
    while codes:
        code = codes.pop()
        codes += [c for c in code.co_consts if isinstance(c, CodeType)]
        constants = [c for c in code.co_consts if not isinstance(c, CodeType)]
        yield repr((code.co_code, constants, code.co_names, code.co_varnames))
        for name in code.co_names:
            value = names.get(name)
            called = getattr(value, "_function", None) or getattr(value, "py_func", None)
            if called is not None:
                yield from _content(called, seen)
            elif isinstance(value, type):
                yield f"{name} {value.__name__} {getattr(value, '_fields', ())}"
            elif isinstance(value, (int, float, complex, str, tuple)):
                yield f"{name} {value!r}"
            elif value is not None and hasattr(value, "tobytes"):
                yield f"{name} {value.tobytes()!r}"


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
    compile_it, load, file = made.compile, made._cache.load_overload, made._cache.lock

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
def _lock(path: Path | None, how: int) -> Iterator[None]:
    """Exclude other processes from the code of a function: all (`LOCK_EX`), or the one that compiles it (`LOCK_SH`).

    Compiling a function also loads or compiles those that it calls, never one that calls it: no two processes wait for
    each other.
    """
    # an RLock excludes the other threads of this process; one thread may take it twice, which flock does not allow
    with _in_this_process:
        # a second flock on another open file would block
        if path is None or path in _held:
            yield
            return
        with ExitStack() as opened:
            # Where the directory is gone, full, or has a lock of another user, the code is compiled without a lock.
            with suppress(OSError):
                path.parent.mkdir(parents=True, exist_ok=True)
                fcntl.flock(opened.enter_context(path.open("w")), how)
            _held.add(path)
            try:
                yield
            finally:
                _held.remove(path)
