from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.api.routes import board_data
from vaoi_station.api.routes.board_data import AGE_S, MOST_PREVIEWS, ImportOptions, Preview, Previews
from vaoi_station.board_data.import_process import ImportReply, ImportTask, run_import
from vaoi_station.errors import InputError, NotFoundError

NOW = [0.0]


def import_here(task: ImportTask) -> ImportReply:
    reply = run_import(task)
    if reply.refusal:
        raise InputError(reply.refusal, action=reply.action)
    return reply


@pytest.fixture
def kept() -> Previews:
    NOW[0] = 0.0
    return Previews(import_here, lambda: NOW[0])


def upload(kept: Previews, text: str = samples.KICAD, name: str = "b.kicad_pcb", **options: str) -> Preview:
    with kept.uploading(name) as (file, path):
        file.write(text.encode())
    return kept.add(path, ImportOptions.model_validate(options))


def test_an_upload_that_cannot_be_imported_leaves_no_file(kept: Previews) -> None:
    with kept.uploading("p.csv") as (_, path):
        pass
    with pytest.raises(NotFoundError):
        kept.add(path, ImportOptions(join="0" * 16))
    assert not path.parent.exists()


def test_the_least_recently_used_go_first_and_old_ones_go(kept: Previews) -> None:
    made = []
    for n in range(MOST_PREVIEWS):
        NOW[0] = float(n)
        made.append(upload(kept))
    NOW[0] += 1
    kept.get(made[0].id)
    newest = upload(kept)
    assert [p.id for p in kept.list()] == [p.id for p in (made[0], *made[2:], newest)]
    assert not made[1].file.exists()
    NOW[0] += AGE_S + 1
    assert kept.list() == ()
    assert not newest.file.exists()


def test_the_size_of_all_replies_is_limited(kept: Previews, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten replies of the largest size would take 320 MB of the station's memory."""
    first = upload(kept)
    assert first.reply is not None
    monkeypatch.setattr(board_data, "MOST_REPLIES", int(3.5 * (len(first.reply.board_type) + len(first.reply.picture))))
    second, third = upload(kept), upload(kept)
    assert [p.id for p in kept.list()] == [first.id, second.id, third.id]
    kept.change(third.id, ImportOptions(repeat="2x2", pitch="60x50"))
    assert [p.id for p in kept.list()] == [second.id, third.id]
    fourth = upload(kept)
    assert [p.id for p in kept.list()] == [third.id, fourth.id]


def test_a_broken_upload_and_the_end_leave_no_file(kept: Previews) -> None:
    with pytest.raises(ConnectionError), kept.uploading("x") as (_, broken):
        raise ConnectionError
    assert not broken.parent.exists()
    path = upload(kept).file
    kept.close()
    assert not Path(path).exists()


@pytest.mark.parametrize(
    ("name", "safe"), [("", "board-data"), ("a\x00b", "a_b"), ("..\\..\\x.tgz", "x.tgz"), ("ü" * 300, "ü" * 100)]
)
def test_names_of_uploads_are_safe(kept: Previews, name: str, safe: str) -> None:
    with kept.uploading(name) as (_, path):
        assert path.name == safe
