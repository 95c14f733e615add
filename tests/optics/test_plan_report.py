from __future__ import annotations

import json
from dataclasses import replace

from vaoi_station.optics import make_plan
from vaoi_station.optics.paper_example import PAPER, compare_with_paper
from vaoi_station.optics.plan_report import format_plan, plan_to_json

PLAN = make_plan(PAPER)


def test_the_json_data_has_all_sections_and_survives_json() -> None:
    document = json.loads(json.dumps(plan_to_json(PLAN)))
    assert set(document) == {"requirements", "array", "lens", "motion", "data", "constraints", "ok", "remedies"}
    assert document["requirements"]["width_mm"] == 400.0
    assert document["array"]["cameras"] == 12
    assert document["ok"] is False
    fields = {"name", "equation", "value", "relation", "limit", "margin", "unit", "ok", "note", "missing"}
    assert all(set(c) == fields for c in document["constraints"])


def test_the_comparison_with_the_paper_is_added_if_given() -> None:
    document = plan_to_json(PLAN, compare_with_paper(PLAN))
    assert [f["name"] for f in document["paper"]][:2] == ["cameras needed", "focal length at d_max"]
    text = format_plan(PLAN, compare_with_paper(PLAN))
    assert "The paper's figures (section 2.6)" in text
    assert "The paper's figures" not in format_plan(PLAN)


def test_the_text_has_three_tables_with_aligned_columns() -> None:
    blocks = format_plan(PLAN).rstrip("\n").split("\n\n")
    assert [b.splitlines()[0] for b in blocks] == [
        "Requirements",
        "Results",
        "Constraints",
        "What would mend what is violated",
    ]
    values = blocks[0].splitlines()[1:]
    assert len({line.index(value) for line, value in zip(values[:3], ("400 mm", "474 mm", "40 px"), strict=True)}) == 1


def test_each_constraint_shows_its_state() -> None:
    lines = format_plan(PLAN).split("Constraints\n")[1].split("\n\n")[0].splitlines()[1:]
    assert len(lines) == len(PLAN.constraints)
    for line, constraint in zip(lines, PLAN.constraints, strict=True):
        assert line.strip().startswith(constraint.name)
        assert {True: " ok", False: " VIOLATED", None: " open "}[constraint.ok] in line


def test_unknown_figures_are_open() -> None:
    text = format_plan(make_plan(replace(PAPER, longest_board_mm=None)))
    for figure in ("rows of the longest board", "memory for one board", "f-number", "depth of field"):
        line = next(line for line in text.splitlines() if line.strip().startswith(figure) and "open" in line)
        assert line.rstrip().endswith("open")


def test_memory_is_in_decimal_megabytes() -> None:
    assert PLAN.data.run_bytes == 694_886_400
    assert "695 MB" in format_plan(PLAN)
