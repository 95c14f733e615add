"""Only PyGObject is taken from the distribution; without it, the rest of the station works."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from vaoi_station.acquisition.cameras.aravis import library
from vaoi_station.errors import DeviceError


@pytest.mark.parametrize(
    ("files", "sentence"),
    [
        ((), "there is no PyGObject in"),
        (("__init__.py",), "is for no Python"),
        (("__init__.py", "_gi.cpython-399-x86_64-linux-gnu.so"), "is for cpython-399-x86_64-linux-gnu"),
    ],
)
def test_an_absent_library_is_reported_with_the_packages_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, files: tuple[str, ...], sentence: str
) -> None:
    (tmp_path / "gi").mkdir()
    for name in files:
        (tmp_path / "gi" / name).touch()
    monkeypatch.setattr(library, "SYSTEM_PACKAGES", tmp_path)
    for name in [name for name in sys.modules if name.split(".")[0] == "gi"]:
        monkeypatch.delitem(sys.modules, name)
    library.aravis.cache_clear()
    with pytest.raises(DeviceError, match=sentence) as caught:
        library.aravis()
    assert "apt install python3-gi gir1.2-aravis-0.8" in caught.value.action
    assert caught.value.code == "aravis-absent"


def test_the_backend_can_be_imported_without_it() -> None:
    """Its modules load PyGObject when the first camera is opened, and not before."""
    code = "import sys; import vaoi_station.acquisition.cameras.aravis; sys.exit('gi' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
