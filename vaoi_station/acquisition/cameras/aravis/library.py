"""The Aravis library through PyGObject, which is the distribution's and lies outside virtual environments.

Only the package `gi` is taken from there: its neighbours in the same directory (another numpy, another pydantic) stay
out of sight. PyGObject is compiled for one minor version of Python; under any other everything but this backend works.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.util
import sys
import warnings
from pathlib import Path
from typing import Any

from vaoi_station.errors import DeviceError

SYSTEM_PACKAGES = Path("/usr/lib/python3/dist-packages")
"""Where Debian and Ubuntu put python3-gi."""
SHARED_OBJECT = "libaravis-0.8.so.0"
PACKAGES = "python3-gi gir1.2-aravis-0.8"


@functools.cache
def aravis() -> Any:
    """The module `gi.repository.Aravis`.

    Raises:
        DeviceError: it is not there, or not for this Python; the action names the packages to install.
    """
    try:
        gi = _gi()
        gi.require_version("Aravis", "0.8")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # PyGObject's overrides of GLib warn of themselves
            from gi.repository import Aravis
    except (ImportError, ValueError, AttributeError) as error:
        raise _absent(error) from error
    return Aravis


@functools.cache
def glib_error() -> type[Exception]:
    """`GLib.Error`, which Aravis raises; `aravis` has been called before."""
    from gi.repository import GLib

    kind: type[Exception] = GLib.Error
    return kind


@functools.cache
def shared_library() -> ctypes.CDLL:
    """The library itself, for what the introspection leaves out."""
    try:
        return ctypes.CDLL(SHARED_OBJECT)
    except OSError as error:
        raise _absent(error) from error


def version() -> tuple[int, int, int]:
    """Of the library in use, which the introspection does not tell."""
    library = shared_library()
    major, minor, micro = (getattr(library, f"arv_get_{part}_version")() for part in ("major", "minor", "micro"))
    return int(major), int(minor), int(micro)


def _gi() -> Any:
    """The package `gi`: this environment's own, or else the distribution's."""
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
    spec = importlib.util.spec_from_file_location("gi", init, submodule_search_locations=[str(package)])
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["gi"] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:  # whatever ended it, a half-made module must not stay; it is raised again
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
