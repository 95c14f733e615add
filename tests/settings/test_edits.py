"""Edits of TOML texts: the data change as asked, everything else stays."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.settings.edits import Edit, apply_edit, edit_toml, without_secrets

ROOT = Path(__file__).resolve().parents[2]
TEXT = """# head
name = "a"   # the name

[line]
speed = [0.0, 1.0] # along
tail = 2

[line.board] # where
side = 1

[[cameras]]
name = "left"

[cameras.features]
X = 1

[[cameras]]
name = "right" # the last

[inline]
mqtt = { host = "h", port = 1 }
list = [{ n = 1 }, { n = 2 }]
"""


def _leaves(data: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    if isinstance(data, dict):
        return [leaf for key, value in data.items() for leaf in _leaves(value, (*path, key))]
    if isinstance(data, list) and data and isinstance(data[0], dict):
        return [leaf for n, value in enumerate(data) for leaf in _leaves(value, (*path, n))]
    return [path]


@pytest.mark.parametrize("name", ["station.toml", "station-paper.toml"])
def test_every_value_of_the_shipped_files_can_be_changed_and_removed(name: str) -> None:
    text = (ROOT / "deploy" / name).read_text(encoding="utf-8")
    comments = re.findall(r"#.*", text)
    for path in _leaves(tomllib.loads(text))[:60]:
        new = edit_toml(text, [Edit(path, "another")])
        expected = tomllib.loads(text)
        apply_edit(expected, Edit(path, "another"))
        assert tomllib.loads(new) == expected
        assert re.findall(r"#.*", new) == comments, path
        assert abs(len(new.splitlines()) - len(text.splitlines())) <= 8  # of an array over several lines
        edit_toml(text, [Edit(path, None)])


@pytest.mark.parametrize(
    ("path", "value", "line"),
    [
        (("name",), "b\"'\\\n", 'name = "b\\"\'\\\\\\n"   # the name'),
        (("line", "tail"), 2.5, "tail = 2.5"),
        (("line", "speed"), [0.0, 2.0], "speed = [0.0, 2.0] # along"),
        (("line", "new"), True, "tail = 2\nnew = true\n\n[line.board]"),
        (("line", "encoder", "counts"), 4.0, "[line.encoder]\ncounts = 4.0"),
        (("workers",), 3, 'name = "a"   # the name\nworkers = 3\n'),
        (("archive", "url"), "/a", '{ n = 2 }]\n\n[archive]\nurl = "/a"\n'),
        (("lights", "red dot"), {"on": 1}, '[lights."red dot"]\non = 1\n'),
        (("cameras", 0, "gain"), 1.0, 'name = "left"\ngain = 1.0\n'),
        (("cameras", 0, "features", "Y"), 2, "X = 1\nY = 2\n"),
        (("cameras", 1, "features"), {"Z": 3}, 'name = "right" # the last\n\n[cameras.features]\nZ = 3\n'),
        (("cameras", 2, "name"), "third", '# the last\n\n[[cameras]]\nname = "third"\n'),
        (("tables", 0, "url"), "u", '[[tables]]\nurl = "u"\n'),
        (("inline", "mqtt", "port"), 2, 'mqtt = { host = "h", port = 2 }'),
        (("inline", "list", 1, "n"), 3, "list = [{ n = 1 }, { n = 3 }]"),
        (("inline", "list", 2), {"n": 9}, "{ n = 2 }, {n = 9}]"),
    ],
)
def test_an_edit_is_written_where_a_person_would_write_it(path: Any, value: Any, line: str) -> None:
    new = edit_toml(TEXT, [Edit(path, value)])
    assert line in new
    assert set(re.findall(r"#.*", TEXT)) <= set(re.findall(r"#.*", new))


def test_tables_and_elements_are_removed_whole_and_indices_are_those_before() -> None:
    new = edit_toml(
        TEXT, [Edit(("cameras", 0), None), Edit(("cameras", 1, "name"), "only"), Edit(("line", "board"), None)]
    )
    assert tomllib.loads(new)["cameras"] == [{"name": "only"}]
    assert "board" not in tomllib.loads(new)["line"]
    assert edit_toml(TEXT, [Edit(("cameras", n), None) for n in (0, 1)]).count("[[") == 0


def test_what_cannot_be_edited_is_refused_and_never_damaged() -> None:
    for path, value in (
        (("line", "absent"), None),
        (("name", "x"), 1),
        (("cameras", 7, "name"), "x"),
        (("cameras", 7), None),
    ):
        with pytest.raises(InputError) as refused:
            edit_toml(TEXT, [Edit(path, value)])
        assert refused.value.code == "not-editable"


SECRETS = """
[archive]
url = "sftp://user:word@store.example/runs" # the store
"""


def test_addresses_show_their_hosts_only() -> None:
    shown = without_secrets(SECRETS, tomllib.loads(SECRETS))
    assert 'url = "sftp://…@store.example/runs" # the store' in shown
    assert "word" not in shown
