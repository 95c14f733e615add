"""Load the Aravis library through PyGObject, which the distribution installs outside virtual environments.

Only the package `gi` is imported from the distribution's directory. Other packages in that directory (another numpy,
another pydantic) stay invisible. PyGObject is compiled for one minor version of Python. With any other version the
station works, except for the backend "aravis".
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError

SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
SHARED_OBJECT = "libaravis-0.8.so.0"
PACKAGES = "python3-gi gir1.2-aravis-0.8"


@functools.cache
def aravis() -> Any:
    """Import and return the module `gi.repository.Aravis`."""
    try:
        gi = _gi()
        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PyGObject's own overrides of GLib raise deprecation warnings
            from gi.repository import Aravis
    except (ImportError, ValueError, AttributeError) as error:
        raise _absent(error) from error
    return Aravis


@functools.cache
def glib_error() -> type[Exception]:
    """Return `GLib.Error`, which Aravis raises; call `aravis` first."""
    from gi.repository import GLib

    kind: type[Exception] = GLib.Error
    return kind


@functools.cache
def shared_library() -> ctypes.CDLL:
    """Load Aravis' C library, for functions that PyGObject does not offer."""
    try:
        return ctypes.CDLL(SHARED_OBJECT)
    except OSError as error:
        raise _absent(error) from error


def version() -> tuple[int, int, int]:
    """Return the version (major, minor, micro) of the loaded Aravis library."""
    library = shared_library()
    major, minor, micro = (getattr(library, f"arv_get_{part}_version")() for part in ("major", "minor", "micro"))
    return int(major), int(minor), int(micro)


def text_of(read: Callable[[], str | None]) -> str:
    """Return a text that a camera has, as its vendor; empty if it has none, or one that is not in UTF-8."""
    try:
        return read() or ""
    except UnicodeDecodeError:
        return ""


def received_bytes(buffer: Any) -> int:
    """Return the number of bytes that were written into an `Aravis.Buffer`. Its frame must be complete."""
    # Through PyGObject, `get_data` would copy all pixels. The hash of a PyGObject is its C pointer.
    size = ctypes.c_size_t()
    _get_data()(hash(buffer), ctypes.byref(size))
    return size.value


@functools.cache
def _get_data() -> Any:
    get_data = shared_library().arv_buffer_get_data
    get_data.argtypes, get_data.restype = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_size_t)], ctypes.c_void_p
    return get_data


def _gi() -> Any:
    """Import the package `gi` from this environment; if it is not there, from the distribution's directory."""
    if "gi" in sys.modules or importlib.util.find_spec("gi") is not None:
        import gi

        return gi
    package = SYSTEM_PACKAGES / "gi"
    init = package / "__init__.py"
    if not init.is_file():
        raise ImportError(f"there is no PyGObject in {SYSTEM_PACKAGES}")
    built = f"_gi.cpython-{sys.version_info[0]}{sys.version_info[1]}"
    if not any(package.glob(f"{built}-*.so")):
        others = sorted(path.name.split(".")[1] for path in package.glob("_gi.*.so"))
        raise ImportError(f"PyGObject in {SYSTEM_PACKAGES} is for {', '.join(others) or 'no Python'}")
    # Loaded by its path: a new entry in sys.path would expose all packages of the distribution.
    spec = importlib.util.spec_from_file_location("gi", init, submodule_search_locations=[str(package)])
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["gi"] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:  # also KeyboardInterrupt: remove the half initialised module, then raise it again
        del sys.modules["gi"]
        raise
    return module


def _absent(error: Exception) -> DeviceError:
    python = f"{sys.version_info[0]}.{sys.version_info[1]}"
    return DeviceError(
        f"Aravis, which drives the cameras, cannot be used from Python {python} at {sys.executable}: {error}.",
        action=f"apt install {PACKAGES}, and run the station with the distribution's own version of Python.",
        code="aravis-absent",
    )
