"""Containers of batches, read by Python's own modules."""

from __future__ import annotations

import io
import zipfile

import pytest

from tests.api.held.replies import unpacked
from vaoi_station.runs.batches.containers import CONTAINERS, ContainerName, ContainerWriter, Member, Packed, pack

TIME_S = 1_700_000_000
FILES = {
    "run.json": b"{}",
    "components/U1/0.raw": bytes(range(256)) * 5,
    f"components/{'R' * 120}/views.json": b'{"views": []}',
    "components/U2/0.raw": b"",
}


def packed(container: ContainerName, *names: str) -> Packed:
    return pack(container, [Member(name, "application/octet-stream", FILES[name]) for name in names], TIME_S)


@pytest.mark.parametrize("container", CONTAINERS)
def test_members_that_were_packed_apart_make_one_container(container: ContainerName) -> None:
    writer = ContainerWriter(container, TIME_S)
    first, *rest = FILES
    content = writer.add(packed(container, first)) + writer.add(packed(container, *rest)) + writer.end()
    assert unpacked(content, container) == FILES


def test_a_zip_file_states_times_modes_and_no_compression() -> None:
    writer = ContainerWriter("zip", TIME_S)
    content = writer.add(packed("zip", *FILES)) + writer.end()
    infos = zipfile.ZipFile(io.BytesIO(content)).infolist()
    assert {i.date_time for i in infos} == {(2023, 11, 14, 22, 13, 20)}
    assert {i.compress_type for i in infos} == {zipfile.ZIP_STORED}
    assert {i.external_attr >> 16 for i in infos} == {0o644}, "Info-ZIP gives members without a mode the mode 000"


def test_a_position_above_4_gib_stands_in_64_bits() -> None:
    writer, far = ContainerWriter("zip", TIME_S), 5 * 2**30
    writer._position = far
    writer.add(packed("zip", "run.json"))
    end = writer.end()
    assert far.to_bytes(8, "little") in end
    assert b"PK\6\6" in end
