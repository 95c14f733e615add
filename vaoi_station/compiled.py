"""Compilation of the few inner loops that numpy and OpenCV cannot do in one pass (docs/decisions/0008)."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

P = ParamSpec("P")
R = TypeVar("R")

_ALLOWED = {"reassoc", "contract", "arcp", "nsz"}
"""Liberties of the compiler: sums may be reordered, to run in vector registers; NaN and ∞ keep their meaning."""


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code when it is first called.

    The code is kept on disk (in `NUMBA_CACHE_DIR`, else beside the module, else in the user's cache), so that only the
    first process after an installation waits for the compiler. The GIL is released while it runs. Results are
    the same on one machine and may differ in the last digits between machines.
    """
    try:
        made = numba.njit(cache=True, nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    except RuntimeError:  # no place on this machine where code may be kept: every process compiles for itself
        made = numba.njit(nogil=True, fastmath=_ALLOWED, error_model="numpy")(function)
    return cast("Callable[P, R]", made)
