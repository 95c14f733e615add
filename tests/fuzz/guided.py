"""Fuzz one target guided by coverage: `python -m tests.fuzz.guided TARGET [options of libFuzzer]`. Needs atheris."""

from __future__ import annotations

import sys
from contextlib import suppress

import atheris

with atheris.instrument_imports(include=["vaoi_station", "tests.fuzz.targets"]):
    from tests.fuzz.targets import run_target
    from vaoi_station.errors import VaoiError

from tests.fuzz.corpus import CORPUS


def main() -> None:
    """Fuzz until a find or an end by the options; libFuzzer writes the find to the working directory."""
    name = sys.argv.pop(1)

    def one(data: bytes) -> None:
        with suppress(VaoiError):
            run_target(name, data)

    atheris.Setup([*sys.argv, str(CORPUS / name)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
