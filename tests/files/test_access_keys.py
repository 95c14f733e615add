"""The file of keys: made, found, rotated and revoked, also by another process."""

from __future__ import annotations

import stat
from pathlib import Path

import pytest

from tests.store.conftest import unreachable
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.files.access_keys import KeyFile


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.json")


def test_a_key_is_found_by_its_secret_which_the_file_does_not_hold(keys: KeyFile) -> None:
    made = keys.create("tester", ["operate"])
    assert keys.find(made.secret) == made.key
    assert made.key.scopes == ("operate",)
    text = keys.path.read_text()
    assert made.secret not in text
    assert made.secret.split("_", 2)[2] not in text
    assert stat.S_IMODE(keys.path.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    "change", [lambda s: s[:-1], lambda s: s + "a", lambda s: s.upper(), lambda _: "", lambda _: "vaoi_"]
)
def test_another_secret_finds_no_key(keys: KeyFile, change: object) -> None:
    made = keys.create("tester", ["read"])
    assert callable(change)
    assert keys.find(change(made.secret)) is None


def test_a_file_that_cannot_be_found_for_certain_is_named_and_counts_as_no_absence(keys: KeyFile) -> None:
    made = keys.create("tester", ["read"])
    with unreachable(keys.path.parent), pytest.raises(DeviceError, match=r"keys\.json: cannot be read \(Permission"):
        keys.find(made.secret)
    assert keys.find(made.secret) == made.key


def test_another_process_makes_and_revokes_keys_without_a_restart(keys: KeyFile) -> None:
    assert keys.entries() == ()
    other = KeyFile(keys.path)
    secret = other.create("tester", ["read"]).secret
    assert keys.find(secret) is not None
    other.revoke("tester")
    assert keys.find(secret) is None


def test_a_rotated_key_keeps_its_scopes_and_ends_the_old_secret(keys: KeyFile) -> None:
    old = keys.create("tester", ["teach", "read"])
    new = keys.rotate("tester")
    assert new.key.scopes == old.key.scopes
    assert keys.find(old.secret) is None
    assert keys.find(new.secret) == new.key


def test_wrong_requests_are_refused(keys: KeyFile) -> None:
    keys.create("tester", ["read"])
    with pytest.raises(StateError, match="There is a key 'tester' already"):
        keys.create("tester", ["read"])
    with pytest.raises(InputError, match="scopes is"):
        keys.create("other", ["root"])
    with pytest.raises(InputError, match="scopes is"):
        keys.create("other", [])
    with pytest.raises(InputError, match="name"):
        keys.create("../x", ["read"])
    with pytest.raises(NotFoundError, match="known keys: 'tester'"):
        keys.revoke("absent")
    assert [k.name for k in keys.entries()] == ["tester"]


def test_a_damaged_file_permits_nobody(keys: KeyFile) -> None:
    secret = keys.create("tester", ["read"]).secret
    keys.path.write_text("{")
    with pytest.raises(InputError, match=r"keys\.json"):
        keys.find(secret)
