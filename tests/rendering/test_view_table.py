"""The views of many components as arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import fields
from typing import Any

import numpy as np

from vaoi_station.rendering import View, ViewCalculator


def test_a_table_is_a_mapping_from_addresses_to_views(make: Any) -> None:
    s = make()
    table = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all(s.board_type.components)
    assert list(table) == [c.address for c in s.board_type.components]
    assert len(table) == len(s.board_type.components)
    assert "no such part" not in table
    for address in table:
        keys = [(v.camera, v.row) for v in table[address]]
        assert keys
        assert len(set(keys)) == len(keys)


def test_the_views_of_one_component_are_those_made_with_all(make: Any) -> None:
    s = make()
    table = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all(s.board_type.components)
    for number, views in enumerate(table.values()):
        alone = table.views_of(number)
        assert len(alone) == len(views) > 0
        for own, view in zip(alone, views, strict=True):
            for field in fields(View):
                assert np.array_equal(getattr(own, field.name), getattr(view, field.name)), field.name


def test_views_in_some_frames_are_counted(make: Any) -> None:
    s = make()
    table = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all(s.board_type.components)
    everywhere = {(v.camera, v.row) for views in table.values() for v in views}
    some = set(sorted(everywhere)[::2])
    expected = Counter({a: sum((v.camera, v.row) in some for v in views) for a, views in table.items()})
    assert table.counts_in(some) == {address: n for address, n in expected.items() if n}
    assert sum(table.counts_in(everywhere).values()) == len(table.columns.component)
    assert table.counts_in(set()) == {}


def test_views_are_collected_by_frame(make: Any) -> None:
    s = make()
    table = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all(s.board_type.components)
    order, begins = table.by_frame()
    assert sorted(order.tolist()) == [*range(len(table.columns.key))]
    ends = [*begins[1:], len(order)]
    keys = [{tuple(key) for key in table.columns.key[order[a:b]].tolist()} for a, b in zip(begins, ends, strict=True)]
    assert all(len(own) == 1 for own in keys)
    assert len(set.union(*keys)) == len(keys)
    nothing = ViewCalculator(s.board_type, s.stitch, s.cameras).compute_all([])
    assert nothing.by_frame()[1] == []
