"""Write the man page and the completion of bash from the command line itself.

python3 deploy/package/command_pages.py DIRECTORY    # DIRECTORY/vaoi.1 and DIRECTORY/vaoi
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer.main

from vaoi_station.cli import app
from vaoi_station.version import __version__


def commands(group: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the words and the object of every command, those of groups too."""
    for name, command in sorted(group.commands.items()):
        if hasattr(command, "commands"):
            yield from commands(command, f"{prefix}{name} ")
        else:
            yield f"{prefix}{name}", command


def man_page() -> str:
    """Return the page vaoi(1) in the language of man(7)."""
    lines = [
        f'.TH VAOI 1 "" "vaoi_station {__version__}" "Video-AOI station"',
        ".SH NAME",
        r"vaoi \- inline Video-AOI station",
        ".SH SYNOPSIS",
        ".B vaoi\n.I COMMAND\n[\n.I OPTIONS\n]",
        ".SH DESCRIPTION",
        _plain(typer.main.get_command(app).help or ""),
        r"The service runs \fBvaoi serve\fR with /etc/vaoi-station/station.toml.",
        ".SH COMMANDS",
    ]
    for words, command in commands(typer.main.get_command(app)):
        lines += [f".SS vaoi {_plain(words)}", _plain(" ".join((command.help or "").split()))]
        for parameter in command.params:
            names = ", ".join(parameter.opts) if parameter.param_type_name == "option" else parameter.name.upper()
            text = " ".join((getattr(parameter, "help", None) or "").split())
            lines += [".TP", rf"\fB{_plain(names)}\fR", _plain(text)]
    lines += [
        ".SH EXIT STATUS",
        "0 without errors, 2 for wrong input, 3 for a device or the present state, 4 for an internal error.",
        r"\fBvaoi check\-config\fR and \fBvaoi doctor\fR: 0 without problems, 1 with warnings, 2 with faults.",
        ".SH ENVIRONMENT",
        ".TP\nVAOI_STATION\naddress of the station, for commands that call a running one",
        ".TP\nVAOI_KEY_FILE, VAOI_KEY\nfile with the caller's key, or the key itself",
        ".TP\nVAOI_CA\nPEM file with the trusted certificate of a station with TLS",
        ".SH FILES",
        ".TP\n/etc/vaoi-station/station.toml\nthe configuration; vaoi check-config states all its faults",
        ".TP\n/var/lib/vaoi-station\nboard types, database, results, references",
        ".TP\n/usr/share/doc/vaoi-station/docs\nthe documents that messages call docs/; administrator.md first",
    ]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Escape what man(7) would interpret."""
    escaped = text.replace("\\", r"\e").replace("-", r"\-").replace("'", r"\(aq")
    return rf"\&{escaped}" if escaped.startswith(".") else escaped


def completion() -> str:
    """Return the completion of bash: commands, their options, and files."""
    every = list(commands(typer.main.get_command(app)))
    first = " ".join(sorted({words.split()[0] for words, _ in every}))
    groups: dict[str, list[str]] = {}
    cases = []
    for words, command in every:
        options = " ".join(o for p in command.params for o in (*p.opts, *p.secondary_opts) if o.startswith("--"))
        cases.append(f'    "{words}") options="{options} --help" ;;')
        if " " in words:
            groups.setdefault(words.split()[0], []).append(words.split()[1])
    inner = [
        f'    {name}) COMPREPLY=($(compgen -W "{" ".join(names)}" -- "$word")); return ;;'
        for name, names in groups.items()
    ]
    return "\n".join(
        [
            "# bash completion for vaoi",
            "_vaoi() {",
            '  local word="${COMP_WORDS[COMP_CWORD]}" options="" command=""',
            '  if [ "$COMP_CWORD" = 1 ]; then',
            f'    COMPREPLY=($(compgen -W "{first} --help --version" -- "$word"))',
            "    return",
            "  fi",
            '  if [ "$COMP_CWORD" = 2 ]; then case "${COMP_WORDS[1]}" in',
            *inner,
            "  esac; fi",
            '  case "${COMP_WORDS[1]}" in',
            f'    {"|".join(groups)}) command="${{COMP_WORDS[1]}} ${{COMP_WORDS[2]}}" ;;',
            '    *) command="${COMP_WORDS[1]}" ;;',
            "  esac",
            '  case "$command" in',
            *cases,
            "  esac",
            '  case "$word" in',
            '    -*) COMPREPLY=($(compgen -W "$options" -- "$word")) ;;',
            '    *) COMPREPLY=($(compgen -f -- "$word")) ;;',
            "  esac",
            "}",
            "complete -o filenames -F _vaoi vaoi",
            "",
        ]
    )


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    (folder / "vaoi.1").write_text(man_page(), encoding="utf-8")
    (folder / "vaoi").write_text(completion(), encoding="utf-8")
