from __future__ import annotations

from pathlib import Path

import pytest

from tests.board_data.readers import samples
from vaoi_station.board_data.readers.html_bom import is_html_bom, read_html_bom
from vaoi_station.errors import InputError


def test_a_page_and_its_data_are_one_design() -> None:
    page = f"<html><title>InteractiveHtmlBom</title><script>var pcbdata = {samples.HTML_BOM};\nvar x = 1;</script>"
    assert is_html_bom(page.encode())
    assert read_html_bom(page.encode(), Path("b.html")) == read_html_bom(samples.HTML_BOM.encode(), Path("b.json"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<html>", "has no readable pcbdata"),
        ("[1]", "pcbdata is a list"),
        ('{"footprints": [{"ref": "R1"}]}', "wrong value at 'bbox'"),
        ('{"footprints": [{"ref": "R1", "layer": "F", "bbox": {"pos": [1], "size": [1, 1]}}]}', "wrong value at"),
        ("[" * 100_000, "has no readable pcbdata"),
    ],
)
def test_wrong_files_are_refused(text: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_html_bom(text.encode(), Path("b.json"))
