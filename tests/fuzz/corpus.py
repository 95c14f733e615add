"""The corpus: small inputs for every target, good ones and those that were finds (tests/fuzz/corpus/TARGET/)."""

from __future__ import annotations

from pathlib import Path

CORPUS = Path(__file__).with_name("corpus")


def inputs(name: str) -> dict[str, bytes]:
    """Return the inputs of a target by the names of their files."""
    return {path.name: path.read_bytes() for path in sorted((CORPUS / name).rglob("*")) if path.is_file()}
