from __future__ import annotations

import random
import tarfile
import zipfile
from contextlib import suppress
from pathlib import Path

import pytest

from vaoi_station.board_data import source_text
from vaoi_station.board_data.source_text import decode, open_archive, parse_xml, read_bytes
from vaoi_station.errors import InputError


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "latin-1"])
def test_encodings_of_old_and_new_programs(encoding: str) -> None:
    assert decode("Größe 5 µm".encode(encoding), "f") == "Größe 5 µm"


def test_a_file_above_the_limit_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(source_text, "MOST_BYTES", 100)
    (tmp_path / "f").write_bytes(bytes(101))
    with pytest.raises(InputError, match="its size is '101 bytes', but must be at most 100 bytes"):
        read_bytes(tmp_path / "f")
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as bomb:
        bomb.writestr("matrix/matrix", bytes(5000))
    with open_archive(tmp_path / "bomb.zip") as archive, pytest.raises(InputError, match="at most 100 bytes"):
        archive.members["matrix/matrix"]()


def test_xml_has_names_without_namespace_and_no_document_type() -> None:
    root = parse_xml(b'<a:b xmlns:a="u"><a:c k="1"/></a:b>', "f")
    assert (root.tag, root[0].tag, root[0].get("k")) == ("b", "c", "1")
    bomb = b'<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><x>&b;</x>'
    with pytest.raises(InputError, match="declares a document type"):
        parse_xml(bomb, "f")
    with pytest.raises(InputError, match="not valid XML at line 1, column 8"):
        parse_xml(b"<a><b></a>", "f")
    with pytest.raises(InputError, match="nested deeper than 200 levels"):
        parse_xml(b"<a>" * 300, "f")


@pytest.mark.parametrize("name", ["../evil", "a/../../evil", "/etc/evil"])
def test_paths_that_lead_out_of_an_archive_are_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "content").write_text("x")
    with tarfile.open(tmp_path / "a.tar", "w") as tar:
        info = tar.gettarinfo(tmp_path / "content")
        info.name = name
        with (tmp_path / "content").open("rb") as content:
            tar.addfile(info, content)
    with pytest.raises(InputError, match="leads out of the archive"), open_archive(tmp_path / "a.tar"):
        pass


def test_folder_zip_and_tar_read_alike(tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "Steps").mkdir(parents=True)
    (folder / "Steps" / "x").write_text("content")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as zipped:
        zipped.write(folder / "Steps" / "x", "Steps/x")
    with tarfile.open(tmp_path / "a.tgz", "w:gz") as tar:
        tar.add(folder / "Steps" / "x", "Steps/x")
    for path in (folder, tmp_path / "a.zip", tmp_path / "a.tgz"):
        with open_archive(path) as archive:
            assert list(archive.members) == ["steps/x"]
            assert archive.members["steps/x"]() == b"content"


@pytest.mark.parametrize("kind", ["zip deflated", "zip lzma", "tar gz", "tar xz", "tar bz2"])
def test_a_damaged_byte_of_an_archive_is_a_refusal(kind: str, tmp_path: Path) -> None:
    container, method = kind.split()
    path, content = tmp_path / "a", random.Random(1).randbytes(3000) * 2
    if container == "zip":
        with zipfile.ZipFile(path, "w", {"deflated": zipfile.ZIP_DEFLATED, "lzma": zipfile.ZIP_LZMA}[method]) as zipped:
            zipped.writestr("steps/x", content)
    else:
        (tmp_path / "x").write_bytes(content)
        with tarfile.open(path, f"w:{method}") as tar:  # type: ignore[call-overload]
            tar.add(tmp_path / "x", "steps/x")
    whole = path.read_bytes()
    for at in range(0, len(whole), 37):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x55]) + whole[at + 1 :])
        with suppress(InputError), open_archive(path) as archive:
            for read in archive.members.values():
                read()


def test_a_damaged_archive_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.zip").write_bytes(b"PK\x03\x04 no zip")
    with pytest.raises(InputError, match=r"a\.zip: is no readable folder, zip or tar file"):  # noqa: SIM117
        with open_archive(tmp_path / "a.zip"):
            pass
