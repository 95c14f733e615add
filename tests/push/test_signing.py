"""Signatures agree with the reference libraries of the specification; secrets are checked and never shown."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import InputError
from vaoi_station.push.signing import MOST_SECRETS, new_secret, read_secrets, secret_bytes, signatures

SECRET = "whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw"
CASE = ("msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, b'{"test": 2432232314}')
EXPECTED = "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="
"""The vector that the libraries of the specification test in every language."""


def test_a_signature_is_that_of_the_reference_libraries() -> None:
    assert signatures([SECRET], *CASE) == EXPECTED


def test_every_secret_signs() -> None:
    first, second = signatures([new_secret(), SECRET], *CASE).split(" ")
    assert second == EXPECTED
    assert first.startswith("v1,")
    assert first != second


def test_a_new_secret_has_256_bits_and_is_another_each_time() -> None:
    assert len(secret_bytes(new_secret(), "x")) == 32
    assert new_secret() != new_secret()


NO_SECRETS = ("", "whsec_", "whsec_c2hvcnQ=", "whsec_" + "A" * 88, SECRET[6:], "whsec_é" + "A" * 40)


@pytest.mark.parametrize("text", NO_SECRETS)
def test_what_is_no_secret_is_refused_without_showing_it(text: str) -> None:
    with pytest.raises(InputError, match="24 to 64 bytes in base64") as refusal:
        secret_bytes(text, "mes.secret")
    assert len(text) < 10 or text not in str(refusal.value)


def test_a_file_has_one_secret_in_each_line(tmp_path: Path) -> None:
    path = tmp_path / "mes.secret"
    path.write_text(f"{SECRET}\n\n{SECRET}\n")
    assert read_secrets(path) == (SECRET, SECRET)
    path.write_text(f"{SECRET}\n" * (MOST_SECRETS + 1))
    with pytest.raises(InputError, match="holds 5 secrets, but must hold 1 to 4"):
        read_secrets(path)
    path.write_text("\n")
    with pytest.raises(InputError, match="holds 0 secrets"):
        read_secrets(path)
    with pytest.raises(InputError, match=r"none: cannot be read \(No such file"):
        read_secrets(tmp_path / "none")
