"""Packages are complete or absent; damaged and hostile ones are refused."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from vaoi_station.errors import DeviceError, GoneError, InputError
from vaoi_station.files.directories import remove_directory
from vaoi_station.transfer import package
from vaoi_station.transfer.package import Entry, open_files, unpack_package, write_package


def make(path: Path) -> Path:
    (path.parent / "big").write_bytes(bytes(range(256)) * 20_000)
    with (path.parent / "big").open("rb") as big:
        write_package(path, "kind", [("a/b.json", b"{}"), ("big", big)], {"x": 1})
    return path


def test_contents_and_manifest_come_back(tmp_path: Path) -> None:
    path = make(tmp_path / "p.tar.gz")
    assert path.stat().st_mode & 0o777 == 0o600
    (tmp_path / "out").mkdir()
    manifest = unpack_package(path, "kind", tmp_path / "out")
    assert manifest["x"] == 1
    assert (tmp_path / "out" / "a" / "b.json").read_bytes() == b"{}"
    assert (tmp_path / "out" / "big").read_bytes() == (tmp_path / "big").read_bytes()
    with pytest.raises(InputError, match="exists already"):
        make(path)


def test_nothing_remains_of_a_package_that_fails(tmp_path: Path) -> None:
    def entries() -> Iterator[Entry]:
        yield "a", b"1"
        raise OSError(28, "No space left on device")

    with pytest.raises(DeviceError, match="cannot be written"):
        write_package(tmp_path / "p", "kind", entries(), {})
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="cannot be written"):
        write_package(tmp_path / "no" / "p", "kind", [], {})


@pytest.mark.parametrize("cut", [0, 1, 100, 5000])
def test_a_package_that_was_cut_short_is_refused(tmp_path: Path, cut: int) -> None:
    path = make(tmp_path / "p")
    path.write_bytes(path.read_bytes()[:cut])
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError):
        unpack_package(path, "kind", tmp_path / "out")


def test_a_package_of_another_kind_or_version_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = make(tmp_path / "p")
    for number in range(3):
        (tmp_path / f"out{number}").mkdir()
    with pytest.raises(InputError, match="no complete package of the format 'other'"):
        unpack_package(path, "other", tmp_path / "out0")
    monkeypatch.setattr(package, "VERSION", 2)
    with pytest.raises(InputError, match="version is 1, but must be 2"):
        unpack_package(path, "kind", tmp_path / "out1")
    with pytest.raises(InputError, match="cannot be unpacked"):
        unpack_package(tmp_path / "absent", "kind", tmp_path / "out2")


def pack(path: Path, *members: tuple[tarfile.TarInfo, bytes]) -> None:
    """Write a tar file by hand, with a manifest that claims nothing."""
    manifest = json.dumps({"format": "kind", "version": 1, "sha256": {}}).encode()
    with tarfile.open(path, "w:gz") as tar:
        for info, content in (*members, (tarfile.TarInfo("manifest.json"), manifest)):
            info.size = len(content)
            tar.addfile(info, io.BytesIO(content))


@pytest.mark.parametrize("name", ["../evil", "/etc/evil", "a/../../evil"])
def test_names_that_lead_elsewhere_are_refused(tmp_path: Path, name: str) -> None:
    pack(tmp_path / "p", (tarfile.TarInfo(name), b"x"))
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="unsafe name"):
        unpack_package(tmp_path / "p", "kind", tmp_path / "out")
    assert not (tmp_path / "evil").exists()


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.FIFOTYPE, tarfile.CHRTYPE])
def test_only_regular_files_are_unpacked(tmp_path: Path, kind: bytes) -> None:
    info = tarfile.TarInfo("link")
    info.type, info.linkname = kind, "/etc/passwd"
    pack(tmp_path / "p", (info, b""))
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="no regular file"):
        unpack_package(tmp_path / "p", "kind", tmp_path / "out")


def test_members_that_the_manifest_does_not_have_or_that_come_twice_are_refused(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    pack(tmp_path / "p", (tarfile.TarInfo("extra"), b"x"))
    with pytest.raises(InputError, match="extra differs from the manifest"):
        unpack_package(tmp_path / "p", "kind", tmp_path / "out")
    pack(tmp_path / "q", (tarfile.TarInfo("twice"), b"x"), (tarfile.TarInfo("twice"), b"y"))
    with pytest.raises(InputError, match="File exists"):
        unpack_package(tmp_path / "q", "kind", tmp_path / "out")


@pytest.mark.parametrize("kind", [tarfile.XHDTYPE, tarfile.XGLTYPE, tarfile.GNUTYPE_LONGNAME])
def test_an_extended_header_is_refused_before_it_is_read(tmp_path: Path, kind: bytes) -> None:
    # `tarfile` would read all of it into memory, and zeros are compressed to a thousandth of their size.
    info = tarfile.TarInfo("header")
    info.type = kind
    pack(tmp_path / "p", (info, bytes(70_000)))
    (tmp_path / "out").mkdir()
    with pytest.raises(InputError, match="extended header has 70000 bytes, the limit is 65536"):
        unpack_package(tmp_path / "p", "kind", tmp_path / "out")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    for name in ("recording.json", "frames/c00_r000.tiff", "run.json"):
        (tmp_path / "r1" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "r1" / name).write_text(name)
    return tmp_path / "r1"


def test_the_head_is_the_last_of_all_files(recording: Path) -> None:
    found = [(name, content.read().decode()) for name, content in open_files(recording)]
    assert found == [(name, name) for name in ("run.json", "frames/c00_r000.tiff", "recording.json")]


@pytest.mark.parametrize("read", [0, 1, 2])
def test_a_deleted_directory_is_named(recording: Path, read: int) -> None:
    files = open_files(recording)
    assert len([next(files) for _ in range(read)]) == read
    remove_directory(recording)
    with pytest.raises(GoneError, match="r1: was deleted while it was read"):
        list(files)
