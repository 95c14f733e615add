"""station.toml as the page reads, checks and writes it."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.api.setup.settings_file import SettingsFile
from vaoi_station.api.setup.settings_models import SettingChange
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import read_config
from vaoi_station.errors import InputError, StateError, VaoiError

SECRET = """
[[push.webhooks]]
name = "chat"
url = "https://chat.example/hooks/T0/secret"
secret_file = "chat.secret"
"""


def _change(**values: Any) -> list[SettingChange]:
    return [SettingChange(key=key.replace("__", "."), value=value) for key, value in values.items()]


def _accept(_: bytes) -> None:
    """Stand for a caller that has read the present file."""


def test_a_change_is_written_with_a_copy_and_is_pending_until_a_restart(files: StationFiles) -> None:
    file = SettingsFile(files)
    before = files.path.read_text()
    assert file.read(file.content()).pending == []
    saved = file.save(_change(line__tail_s=1, cameras__1__gain_db=2), _accept)
    assert files.path.read_text() == before.replace("tail_s = 0.48", "tail_s = 1.0").replace(
        'name = "cam1"', 'name = "cam1"', 1
    ).replace(
        "nominal_center_mm = [36.0, 0.0]\nnominal_px_per_mm = 8.0\n",
        "nominal_center_mm = [36.0, 0.0]\nnominal_px_per_mm = 8.0\ngain_db = 2.0\n",
    )
    assert saved.backup is not None
    assert files.path.with_name(saved.backup).read_text() == before
    assert saved.changed == ["line.tail_s", "cameras.1.gain_db"]
    assert file.read(file.content()).pending == ["line.tail_s", "cameras.1.gain_db"]
    assert read_config(files.path).line.tail_s == 1.0


def test_all_faults_are_found_at_once_and_none_of_them_is_saved(files: StationFiles) -> None:
    file = SettingsFile(files)
    wrong = _change(workers=0, line__tail_s="long", cameras__2__name="cam1", line__typo=1, name__x=1)
    proposal = file.propose(wrong, file.content())
    # What cannot be edited prevents the edits; without it, every fault of the model is found.
    assert [f.key for f in proposal.faults] == ["name.x"]
    proposal = file.propose(wrong[:-1], file.content())
    assert {f.key for f in proposal.faults} == {"workers", "line.tail_s", "line.typo", ""}
    before = files.path.read_bytes()
    for changes in (wrong, wrong[:1]):
        with pytest.raises(InputError):
            file.save(changes, _accept)
    assert files.path.read_bytes() == before


def test_files_that_are_not_there_are_noted(files: StationFiles) -> None:
    notes = SettingsFile(files).propose(_change(flat_fields="flats", data="new"), files.path.read_bytes()).notes
    assert [(note.key, note.message) for note in notes] == [
        ("flat_fields", "flats: there is no such file for the service")
    ]


def test_secrets_stay_in_the_file_and_are_never_shown(files: StationFiles) -> None:
    files.path.write_text(files.path.read_text() + SECRET)
    file = SettingsFile(files)
    read = file.read(file.content())
    assert read.hidden == ["push.webhooks.0.url"]
    proposal = file.propose(_change(push__webhooks__0__name="talk"), file.content())
    assert proposal.hidden == 1
    assert "T0" not in read.model_dump_json() + proposal.model_dump_json()
    assert 'url = "https://chat.example/…"' in proposal.text
    shown = proposal.text.split('url = "')[1].split('"')[0]
    assert file.propose(_change(push__webhooks__0__url=shown), file.content()).faults[0].key == "push.webhooks.0.url"
    file.save(_change(push__webhooks__0__name="talk"), _accept)
    assert "hooks/T0/secret" in files.path.read_text()


def test_a_file_that_the_service_may_not_write_is_shown_checked_and_left(protected: StationFiles) -> None:
    file = SettingsFile(protected)
    read = file.read(file.content())
    assert not read.writable
    assert read.install.endswith(f" station.toml {protected.path}")
    assert read.restart.startswith(f"sudo vaoi check-config {protected.path} && ")
    proposal = file.propose(_change(workers=3), file.content())
    assert (proposal.faults, "+workers = 3" in proposal.diff) == ([], True)
    before = file.content()
    with pytest.raises(StateError) as refused:
        file.save(_change(workers=3), _accept)
    assert (refused.value.code, file.content()) == ("settings-read-only", before)


def test_a_file_with_faults_is_read_and_can_be_corrected(files: StationFiles) -> None:
    files.path.write_text(files.path.read_text().replace("tail_s = 0.48", 'tail_s = "x"\nodd = 1'))
    file = SettingsFile(files)
    read = file.read(file.content())
    assert ([f.key for f in read.faults], read.pending) == (["line.tail_s", "line.odd"], [])
    file.save(_change(line__tail_s=0.48, line__odd=None), _accept)
    assert file.read(file.content()).faults == []


@pytest.mark.parametrize("content", [b"a = ", b"\xff", b"a = 1" + b"0" * 5000])
def test_what_is_no_toml_is_refused(files: StationFiles, content: bytes) -> None:
    files.path.write_bytes(content)
    file = SettingsFile(files)
    with pytest.raises(VaoiError, match=r"station\.toml"):
        file.read(file.content())


def test_lights_by_name_and_further_cameras_can_be_added_and_removed(files: StationFiles) -> None:
    file = SettingsFile(files)
    given = {"name": "cam3", "width": 320, "height": 240, "exposure_us": 100}
    changes = _change(controller__lights__red__on_us=80, controller__lights__red__channels=[0])
    changes += [SettingChange(key=f"cameras.3.{key}", value=value) for key, value in given.items()]
    proposal = file.propose([*changes, SettingChange(key="cameras.0")], file.content())
    assert proposal.faults == []
    file.save([*changes, SettingChange(key="cameras.0")], _accept)
    config = read_config(files.path)
    assert [camera.name for camera in config.cameras] == ["cam1", "cam2", "cam3"]
    assert config.controller.lights["red"].on_us == 80.0
    assert "exposure_us = 100.0" in files.path.read_text()


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_a_file_with_a_byte_order_mark_is_read_and_saved_without_it(files: StationFiles, encoding: str) -> None:
    file, text = SettingsFile(files), files.path.read_text()
    plain = file.read(file.content())
    files.path.write_bytes(text.encode(encoding))
    assert file.read(file.content()) == plain
    proposal = file.propose(_change(line__tail_s=1), file.content())
    assert (proposal.changed, proposal.text.startswith("# A station")) == (["line.tail_s"], True)
    saved = file.save(_change(line__tail_s=1), _accept)
    assert files.path.read_text() == text.replace("tail_s = 0.48", "tail_s = 1.0")
    assert (files.path.parent / str(saved.backup)).read_bytes() == text.encode(encoding)


def test_a_file_in_utf_16_without_a_mark_is_refused_with_an_action(files: StationFiles) -> None:
    file = SettingsFile(files)
    with pytest.raises(InputError, match=r"station\.toml: has a zero character.* Save it as UTF-8"):
        file.read(files.path.read_text().encode("utf-16-le"))
