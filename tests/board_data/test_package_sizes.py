from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.board_data.package_sizes import parse_table, read_table, shipped_table, size_of
from vaoi_station.errors import InputError


@pytest.mark.parametrize(
    ("package", "size"),
    [
        ("R_0603_1608Metric", (1.6, 0.8)),
        ("C_0201_0603Metric", (0.6, 0.3)),
        ("SOIC-8_3.9x4.9mm_P1.27mm", (3.9, 4.9)),
        ("CAPC1005X55N", (1.0, 0.5)),
        ("QFN50P700X700X80-48N", (7.0, 7.0)),
        ("C0402", (1.0, 0.5)),
        ("CC0402", (1.0, 0.5)),
        ("R0805", (2.0, 1.25)),
        ("SOT-23", (1.3, 2.9)),
        ("SOT-23-5", (1.3, 2.9)),
        ("SOD323", (1.7, 1.25)),
        ("TSSOP-16", (4.4, 5.0)),
        ("LQFP-64", (10.0, 10.0)),
        ("PinHeader_1x05_P2.54mm_Vertical", (2.54, 12.7)),
        ("Fiducial_0.75mm_Mask1.5mm", (0.75, 0.75)),
    ],
)
def test_names_of_packages_carry_their_size(package: str, size: tuple[float, float]) -> None:
    assert size_of(package, shipped_table()) == pytest.approx(size)


def test_a_table_of_the_user(tmp_path: Path) -> None:
    (tmp_path / "t.toml").write_text("[[package]]\npattern = 'custom-7'\nsize = [12, 8.5]\n")
    assert size_of("CUSTOM-7", read_table(tmp_path / "t.toml")) == (12.0, 8.5)
    assert size_of("CUSTOM-7", parse_table((tmp_path / "t.toml").read_text(), "sizes")) == (12.0, 8.5)
    with pytest.raises(InputError, match=r"sizes: has no \[\[package\]\]"):
        parse_table("", "sizes")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"has no \[\[package\]\]"),
        ("[[package]]\npattern = 'a'\n", r"package\.0 is .* but must be a table with pattern and size"),
        (
            "[[package]]\npattern = 'a'\nsize = [1]\n",
            r"package\.0\.size is \[1\], but must be \[x, y\] from 0\.1 to 300",
        ),
        ("[[package]]\npattern = 'a'\nsize = [0.01, 1]\n", r"package\.0\.size"),
        ("[[package]]\npattern = '('\nsize = [1, 1]\n", r"package\.0\.pattern is '\('"),
    ],
)
def test_wrong_tables_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_table(tmp_path / "t.toml")
