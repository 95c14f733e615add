"""The key and the trusted certificate of a program that calls a station: where they come from, what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import InputError
from vaoi_station.files.caller_credentials import caller_credentials

KEY = "vaoi_0123456789ab_secret-part"


@pytest.fixture
def key_file(tmp_path: Path) -> Path:
    path = tmp_path / "key"
    path.write_text(f"{KEY}\n")
    return path


def test_a_key_comes_from_the_argument_the_file_or_the_environment(key_file: Path, tmp_path: Path) -> None:
    given = {"VAOI_KEY": "other", "VAOI_KEY_FILE": str(tmp_path / "absent"), "VAOI_CA": "ca.pem"}
    expected = {"Authorization": f"Bearer {KEY}"}
    assert caller_credentials(key=KEY, environment=given).headers() == expected
    assert caller_credentials(key_file, environment=given).headers() == expected
    assert caller_credentials(environment={"VAOI_KEY": KEY}).headers() == expected
    assert caller_credentials(environment={"VAOI_KEY_FILE": str(key_file)}).headers() == expected
    assert caller_credentials(environment=given).ca == Path("ca.pem")
    assert caller_credentials(ca=tmp_path, environment=given).ca == tmp_path


@pytest.mark.parametrize("text", ["", "two words", "one\nX-Header: 1", "ü", "x" * 201])
def test_what_cannot_be_a_key_is_refused_without_showing_it(key_file: Path, text: str) -> None:
    key_file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="not one key") as refusal:
        caller_credentials(key_file, environment={})
    assert not text or text not in str(refusal.value)


def test_neither_text_nor_errors_show_the_key() -> None:
    assert KEY not in repr(caller_credentials(key=KEY, environment={}))


def test_a_file_that_is_no_certificate_is_refused(key_file: Path) -> None:
    with pytest.raises(InputError, match="cannot be used as a trusted certificate"):
        caller_credentials(ca=key_file, environment={}).tls_context()
