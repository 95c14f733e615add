"""Schemas of the requests and replies about the settings of a station: its station.toml."""

from __future__ import annotations

from typing import Any, Literal

from pydantic import BaseModel, Field

from vaoi_station.model import Strict


class Setting(BaseModel):
    """One key of station.toml, as the configuration model describes it."""

    key: str = Field(description="`line.tail_s`; `cameras[].width` in arrays, `controller.lights.NAME.on_us` by name.")
    table: str = Field(description="The table that has it; empty for the file's own level.")
    kind: Literal["text", "path", "number", "integer", "truth", "choice", "list", "map"]
    required: bool = Field(description="Whether its table needs it.")
    default: str | None = Field(default=None, description="As TOML; absent: none.")
    unit: str | None = None
    choices: list[str] = []
    minimum: float | None = None
    above: float | None = Field(default=None, description="The value must be above it.")
    maximum: float | None = None
    below: float | None = Field(default=None, description="The value must be below it.")
    description: str
    optional_table: bool = Field(description="Whether the whole table may be absent.")


class SettingFault(BaseModel):
    """What is wrong in a station.toml."""

    key: str = Field(description="`cameras.1.width`; empty if several tables contradict each other.")
    message: str


class Settings(BaseModel):
    """station.toml as it is on disk. What may be secret is hidden: `…` stands in its place."""

    path: str
    text: str = Field(description="The file, with its comments.")
    values: dict[str, Any] = Field(description="What it says, by table and key.")
    keys: list[Setting] = Field(description="All keys that it may have.")
    faults: list[SettingFault]
    hidden: list[str] = Field(description="Keys of which a part is hidden. Entered anew, they are entered whole.")
    pending: list[str] = Field(description="Keys that were changed since the start of the station: a restart is due.")
    writable: bool = Field(description="Whether the service may write the file. Else an administrator puts it there.")
    install: str = Field(description="The command by which an administrator puts a file there.")
    restart: str = Field(description="The command that restarts the service. Everything in the file needs it.")


class SettingChange(Strict):
    """A value that shall stand in station.toml from now on."""

    key: str = Field(
        description="`line.tail_s`, `cameras.0.width`; the index after the last one appends a table.",
        pattern=r"^[^.\x00-\x1f]+(\.[^.\x00-\x1f]+)*$",
        max_length=300,
    )
    value: Any = Field(default=None, description="Absent or null removes the key, the table or the array's element.")


class SettingsChange(Strict):
    """Changes of station.toml. They are made together or not at all."""

    changes: list[SettingChange] = Field(min_length=1, max_length=500)


class SettingsProposal(BaseModel):
    """What station.toml would be after the changes. Secrets are hidden as in `Settings`."""

    faults: list[SettingFault] = Field(description="All of them; with any, nothing can be saved.")
    notes: list[SettingFault] = Field(description="What may be a mistake: files that the service does not find.")
    changed: list[str] = Field(description="Keys with another value.")
    diff: str = Field(description="The lines that change, as a unified diff.")
    text: str = Field(description="The new file.")
    hidden: int = Field(description="Number of hidden values in it, which must be entered before it can be used.")


class SettingsSaved(BaseModel):
    """station.toml was written. It is in force from the next start of the station on."""

    path: str
    backup: str | None = Field(default=None, description="Name of the copy of the file before.")
    changed: list[str]
    restart: str
