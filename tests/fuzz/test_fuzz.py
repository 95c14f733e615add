"""The corpus of the fuzzers is replayed; each is also run for a moment."""

from __future__ import annotations

import random
from contextlib import suppress

import pytest

from tests.fuzz.corpus import CORPUS, inputs
from tests.fuzz.mutation import mutated
from tests.fuzz.targets import TARGETS, operation_of, operations, run_target
from tests.needs import LONG
from vaoi_station.errors import VaoiError

MUTATIONS = 5000 if LONG else 15


@pytest.mark.parametrize("name", TARGETS)
def test_no_input_of_the_corpus_is_an_internal_error(name: str) -> None:
    accepted = 0
    for data in inputs(name).values():
        with suppress(VaoiError):
            run_target(name, data)
            accepted += 1
    assert accepted, "a corpus without a good input does not get behind the first check"


@pytest.mark.parametrize("name", TARGETS)
def test_no_mutation_is_an_internal_error(name: str) -> None:
    known = list(inputs(name).values())
    for seed in range(MUTATIONS):
        chance = random.Random(seed)
        data = mutated(chance.choice(known), known, chance)
        with suppress(VaoiError):
            try:
                run_target(name, data)
            except Exception as error:
                if not isinstance(error, VaoiError):
                    error.add_note(f"{name}, seed {seed}: {data[:400]!r}")
                raise


def test_every_target_has_a_corpus_and_every_corpus_a_target() -> None:
    assert {path.name for path in CORPUS.iterdir()} == set(TARGETS)
    assert max(path.stat().st_size for path in CORPUS.rglob("*") if path.is_file()) < 40_000
    chosen = {operation_of(data)[:2] for data in inputs("rest").values()}
    assert chosen == set(operations()), "an input for every operation with a body"
