"""Mutations of inputs: bytes, and the tree of a JSON or TOML document."""

from __future__ import annotations

import copy
import json
import random
import tomllib
from typing import Any

NASTY: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 2**31, 2**53, 2**63, 2**64, -(2**63), 10**40, 1e308, -1e308, 5e-324, 0.1, -0.0,
    "", " ", ".", "..", "/", "a/b", "\0", "\n", "\ud800", "x" * 300, "é", "1", "nan", "{}", [], {}, [[]], [0], [{}],
    {"": 0}, [1e308, 1e308], [[1, 0, 0], [0, 1, 0], [0, 0, 0]],
)  # fmt: skip
"""Values at the limits of types and of their uses."""
_BYTES = (
    b"\0",
    b"\xff",
    b"[" * 5000,
    b"9" * 5000,
    b"\xed\xa0\x80",
    b"\x1f\x8b",
    b'"',
    b"{",
    b"}",
    b"[",
    b"]",
    b"=",
    b"e999",
)


def mutated(data: bytes, others: list[bytes], chance: random.Random) -> bytes:
    """Return a changed input: of its document if it is one, else of its bytes."""
    if chance.random() < 0.7:
        for parse, write in ((json.loads, _as_json), (_toml, _as_toml)):
            try:
                document = parse(data)
                for _ in range(chance.choice([1, 1, 1, 2, 4])):
                    document = _changed(document, chance)
                return write(document)
            except (ValueError, TypeError, RecursionError, AssertionError):
                continue
    return _changed_bytes(data, others, chance)


def _changed(document: Any, chance: random.Random) -> Any:
    """Change one place of a tree."""
    document = copy.deepcopy(document)
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            places.append((node, key))
            collect(node[key])

    collect(document)
    if not places:
        return chance.choice(NASTY)
    parent, key = chance.choice(places)
    action = chance.randrange(6)
    if action <= 2:
        parent[key] = copy.deepcopy(chance.choice(NASTY))
    elif action == 3:
        del parent[key]
    elif action == 4:
        parent[key] = copy.deepcopy(chance.choice(places)[0])
    elif isinstance(parent, list):
        parent.extend(copy.deepcopy(parent[key]) for _ in range(chance.choice([1, 3, 50])))
    else:
        parent[chance.choice(["", "x", "\0", "format", "version"])] = chance.choice(NASTY)
    return document


def _changed_bytes(data: bytes, others: list[bytes], chance: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(chance.choice([1, 1, 2, 4, 8])):
        at = chance.randint(0, len(changed))
        action = chance.randrange(5)
        if action == 0 and changed:
            changed[min(at, len(changed) - 1)] ^= 1 << chance.randrange(8)
        elif action == 1:
            changed[at:at] = chance.choice(_BYTES)
        elif action == 2:
            del changed[at : at + chance.choice([1, 4, 64])]
        elif action == 3:
            changed[at:at] = bytes(chance.randrange(256) for _ in range(chance.randrange(1, 9)))
        else:
            other = chance.choice(others)
            changed[at:] = other[chance.randint(0, len(other)) :]
    return bytes(changed[:100_000])


def _toml(data: bytes) -> dict[str, Any]:
    return tomllib.loads(data.decode())


def _as_toml(document: Any) -> bytes:
    """Write a document with tables in lines; ValueError for what TOML does not have."""
    return "\n".join(f"{json.dumps(key)} = {_inline(value)}" for key, value in document.items()).encode()


def _inline(value: Any) -> str:
    if value is None:
        raise ValueError("TOML has no null")
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_inline(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_inline, value)) + "]"
    return json.dumps(value)


def _as_json(document: Any) -> bytes:
    return json.dumps(document).encode()
