"""An attack in a process of its own, so that it shares no interpreter with the honest caller.

`python -m tests.attack.attacker ATTACK PORT RUN [KEY]` attacks until its input ends.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tests.attack.attacks import ATTACKS, Target
from tests.attack.measuring import attacked


@contextmanager
def attacked_by_process(target: Target, name: str) -> Iterator[list[int]]:
    """Run an attack in a process while the context is entered, and yield its process id; none if there is no attack."""
    if name not in ATTACKS:
        yield []
        return
    command = [sys.executable, "-m", "tests.attack.attacker", name, str(target.port), target.run, target.key]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdout.readline()  # it has imported everything, and begins
        try:
            yield [process.pid]
        finally:
            process.stdin.close()


def processor_s(pid: int) -> float:
    """Return the processor time that a process has used, without that of its children, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def main() -> None:
    name, port, run, key = sys.argv[1:]
    print(name, flush=True)
    with attacked(Target(int(port), run, key), ATTACKS[name]):
        sys.stdin.read()


if __name__ == "__main__":
    main()
