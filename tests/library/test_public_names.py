"""The list of public names is complete, and importing the package is cheap."""

from __future__ import annotations

import subprocess
import sys

import pytest

import vaoi_station as vaoi


def test_every_public_name_can_be_imported() -> None:
    for name in vaoi.__all__:
        assert getattr(vaoi, name) is not None, name
    assert set(vaoi.__all__) <= set(dir(vaoi))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = vaoi.nonsense


def test_importing_the_package_loads_neither_numpy_nor_numba() -> None:
    code = "import sys, vaoi_station; print(sorted({'numpy', 'numba', 'cv2', 'pydantic'} & set(sys.modules)))"
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert shown.strip() == "[]"
