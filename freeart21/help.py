"""`--help` that fits a screen, written from the signatures and docstrings of the commands."""

from __future__ import annotations

import dataclasses
import inspect
import re
import shutil
import textwrap
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin, get_type_hints

import tyro

WIDTH = 100
"""Columns that a help text has at most."""
_COLUMN = 27
_METAVARS = {int: "N", float: "NUMBER", str: "NAME", Path: "PATH"}
OPTION_GROUPS: dict[str, dict[str, tuple[str, ...]]] = {
    "record": {
        "what is filmed": ("procedural", "count", "split", "partnet_root", "joint", "skip_missing", "root"),
        "how it moves": ("motion", "carry", "seed", "effects", "let_go"),
        "how it is filmed": ("frames", "preset", "sensor", "camera", "queries", "width", "height", "shader"),
    },
    "teleop": {
        "what is moved": ("seed", "partnet_root", "joint", "skip_missing", "root"),
        "the server and its picture": ("host", "port", "width", "height"),
    },
    "measure": {
        "of files": ("asset", "joint", "columns", "unit_t", "unit_q", "unit_effort", "zero", "reverse", "held_out"),
        "what drove it, and how sure the asset is": (
            "effort",
            "actuator",
            "interpolation",
            "circumstances",
            "inertia_relative",
            "gravity_relative",
        ),
        "of truths, the errors of a tracker": ("noise_mm", "noise_deg", "seed", "partnet_root", "urdf", "root"),
    },
}
"""Command to headings and their options; what is in none comes first."""


def top_help(commands: dict[str, Callable[..., Any]], description: str) -> str:
    """The help of the program: every command with one line."""
    width = _width()
    lines = ["usage: freeart21 COMMAND [OPTIONS]", "", *textwrap.wrap(description, width), "", "commands:"]
    for name, f in commands.items():
        said = inspect.getdoc(f) or ""
        line = said.splitlines()[0] if said else ""
        for end in (r":| \(", ","):
            if len(line) > width - 20:
                line = re.split(end, line)[0] + "."
        lines.append(f"  {name:16}  {line}")
    return "\n".join(
        [*lines, "", "`freeart21 COMMAND --help` tells a command's options; `freeart21 --version` the version."]
    )


def command_help(name: str, f: Callable[..., Any]) -> str:
    """The help of one command: usage, what it does, and its options with their units and defaults."""
    summary, said = _docstring(f)
    hints = get_type_hints(f, include_extras=True)
    parameters = list(inspect.signature(f).parameters.values())
    positional = [p for p in parameters if tyro.conf.Positional in _markers(hints[p.name])]
    options = [p for p in parameters if p not in positional]
    required = [p for p in options if p.default is inspect.Parameter.empty]
    usage = " ".join(
        ["usage: freeart21", name]
        + [_positional(p, hints[p.name]) for p in positional]
        + [f"{_flag(p.name, hints[p.name])} {_metavar(hints[p.name])}" for p in required]
        + (["[OPTIONS]"] if len(options) > len(required) else [])
    )
    lines = [usage, ""]
    for paragraph in summary.split("\n\n"):
        lines += [*textwrap.wrap(paragraph, _width()), ""]
    for p in positional:
        lines += _entry(_positional(p, hints[p.name]).strip("[]"), said.get(p.name, ""), p.default)
    groups = OPTION_GROUPS.get(name, {})
    grouped = {option for names in groups.values() for option in names}
    headed = {"options": tuple(p.name for p in options if p.name not in grouped), **groups}
    by_name = {p.name: p for p in options}
    for heading, names in headed.items():
        lines += ["", f"{heading}:"] if heading in groups or positional else [f"{heading}:"]
        for option in names:
            hint = hints[option]
            metavar = _metavar(hint)
            lines += _entry(
                f"{_flag(option, hint)} {metavar}".replace(" .", ".").rstrip(),
                said.get(option) or _said(hint, "help") or "",
                by_name[option].default,
            )
    return "\n".join(lines)


def _entry(left: str, text: str, default: object) -> Iterator[str]:
    """An option and what it is, the text in a column of its own."""
    plain = default is inspect.Parameter.empty or default is None or default is False or default == ()
    if not plain and not dataclasses.is_dataclass(default):
        shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
        text = f"{text.rstrip('.')} [{shown}]"
    wrapped = textwrap.wrap(text, _width() - _COLUMN, break_on_hyphens=False) or [""]
    first = f"  {left}"
    if len(first) > _COLUMN - 2:
        yield first
        first = ""
    yield f"{first:{_COLUMN}}{wrapped[0]}"
    for line in wrapped[1:]:
        yield " " * _COLUMN + line


def _width() -> int:
    return max(60, min(WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns))


def _docstring(f: Callable[..., Any]) -> tuple[str, dict[str, str]]:
    """What stands before "Args:", and the text of each argument."""
    summary, _, listed = (inspect.getdoc(f) or "").partition("\nArgs:\n")
    said: dict[str, str] = {}
    name = ""
    for line in listed.splitlines():
        begins = re.match(r" {4}(\w+): (.*)", line)
        if begins:
            name = begins[1]
            said[name] = begins[2]
        elif name:
            said[name] += " " + line.strip()
    return summary.strip(), said


def _markers(hint: Any) -> tuple[Any, ...]:
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def _said(hint: Any, what: str) -> Any:
    """What `tyro.conf.arg` says of a parameter: its name, metavar or help."""
    told = [m for m in _markers(hint) if hasattr(m, "help_behavior_hint")]
    return getattr(told[0], what) if told else None


def _flag(name: str, hint: Any) -> str:
    return "--" + (_said(hint, "name") or name).replace("_", "-")


def _positional(p: inspect.Parameter, hint: Any) -> str:
    many = get_origin(get_args(hint)[0]) is tuple
    word = p.name.upper() + ("..." if many else "")
    return word if p.default is inspect.Parameter.empty else f"[{word}]"


def _metavar(hint: Any) -> str:
    """What stands for the value of an option: nothing for a switch."""
    told = _said(hint, "metavar")
    if told is not None:
        return str(told)
    bare = get_args(hint)[0] if get_origin(hint) is Annotated else hint
    if get_origin(bare) in (Union, types.UnionType):
        bare = next(a for a in get_args(bare) if a is not type(None))
    if bare is bool:
        return ""
    if get_origin(bare) is Literal:
        return "|".join(str(a) for a in get_args(bare))
    if get_origin(bare) is tuple:
        inner = get_args(bare)
        return f"{_metavar(inner[0])}..." if inner[-1] is Ellipsis else " ".join(_metavar(a) for a in inner)
    return ".NAME VALUE" if dataclasses.is_dataclass(bare) else _METAVARS.get(bare, "VALUE")
