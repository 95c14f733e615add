"""Qpid Proton, the library of AMQP 1.0: from this environment, or the distribution's package."""

from __future__ import annotations

import importlib.util
import sys
import time
from importlib.machinery import PathFinder
from types import SimpleNamespace

from vaoi_station.acquisition.cameras.aravis.library import SYSTEM_PACKAGES
from vaoi_station.errors import DeviceError

_MODULES = ("_cproton", "cproton", "proton")
"""Modules of Debian's package, each of which needs those before."""
_TIMED = ("_utils", "_reactor", "_io", "_handlers")
"""Modules of the library that read the clock, all of them for waiting times."""


def load() -> None:
    """Make `import proton` possible; DeviceError with the cause and what to install, if that fails."""
    try:
        if importlib.util.find_spec("proton") is None:
            _load_from_distribution()
        import proton.utils  # a library of another Python fails here
    except ImportError as error:
        raise DeviceError(
            f"push.cfx is set, but Qpid Proton cannot be used: {error}.",
            action="apt install python3-qpid-proton (for the distribution's own version of Python), "
            "or pip install 'vaoi-station[cfx]'.",
            code="cfx-package-absent",
        ) from error
    # With the time of day, a wait would last for as long as the clock is set back meanwhile.
    for module in (getattr(proton, name, None) for name in _TIMED):
        if hasattr(module, "time"):
            vars(module)["time"] = SimpleNamespace(time=time.monotonic, sleep=time.sleep)


def _load_from_distribution() -> None:
    """Load the distribution's modules by their paths; its directory in `sys.path` would expose all its packages."""
    loaded: list[str] = []
    try:
        for name in _MODULES:
            spec = PathFinder.find_spec(name, [str(SYSTEM_PACKAGES)])
            if spec is None or spec.loader is None:
                raise ImportError(f"{SYSTEM_PACKAGES} has no {name} for this Python")
            sys.modules[name] = module = importlib.util.module_from_spec(spec)
            loaded.append(name)
            spec.loader.exec_module(module)
    except BaseException:  # also KeyboardInterrupt: remove half initialised modules, then raise it again
        for name in loaded:
            del sys.modules[name]
        raise
