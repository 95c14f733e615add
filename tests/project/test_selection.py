"""The quick loop chooses the tests of what changed."""

from __future__ import annotations

from tests.project.selection import ALWAYS, SLOW, changed_files, quick_tests, select_tests


def test_a_changed_module_brings_its_test_and_the_room_around_it() -> None:
    chosen = select_tests(["vaoi_station/geometry/lens.py"])
    assert "tests/geometry/test_transforms.py" in chosen
    assert set(ALWAYS) <= set(chosen)
    assert all(path.startswith("tests/geometry/") or path in ALWAYS for path in chosen)


def test_a_changed_module_of_a_slow_room_brings_its_own_test_only() -> None:
    assert select_tests(["vaoi_station/acquisition/pairing/proof.py"]) == [
        "tests/acquisition/pairing/test_proof.py",
        *ALWAYS,
    ]


def test_a_changed_test_is_chosen_itself() -> None:
    assert select_tests(["tests/project/test_needs.py"]) == sorted([*ALWAYS, "tests/project/test_needs.py"])


def test_without_changes_all_quick_tests_are_chosen() -> None:
    chosen = select_tests([])
    assert chosen == quick_tests()
    assert "tests/geometry" in chosen
    assert not {f"tests/{folder}" for folder in SLOW} & set(chosen)


def test_removed_files_are_passed_over() -> None:
    assert select_tests(["vaoi_station/absent.py"]) == quick_tests()


def test_the_working_tree_can_be_compared() -> None:
    assert all(isinstance(path, str) and path for path in changed_files())


def test_a_file_without_a_rule_brings_all_quick_tests() -> None:
    for path in ("vaoi_station/errors.py", "vaoi_station/simulation/scenarios/small.toml", "tests/conftest.py"):
        assert select_tests(["vaoi_station/geometry/lens.py", path]) == quick_tests()


def test_pages_and_examples_bring_their_tests() -> None:
    chosen = select_tests(["vaoi_station/api/web/app.js", "docs/examples/probe_coordinates.py"])
    assert {"tests/api/web", "tests/library/test_examples.py"} <= set(chosen)
