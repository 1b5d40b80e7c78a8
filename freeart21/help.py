"""`--help` texts that fit a screen, made from the signatures and docstrings of the commands."""

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
"""Largest width of a help text, columns."""
_COLUMN = 27
_METAVARS = {int: "N", float: "NUMBER", str: "NAME", Path: "PATH"}
OPTION_GROUPS: dict[str, dict[str, tuple[str, ...]]] = {
    "record": {
        "the objects": ("procedural", "count", "split", "partnet_root", "joint", "skip_missing", "root"),
        "the motion": ("motion", "carry", "seed", "effects", "let_go"),
        "the camera": ("frames", "preset", "sensor", "camera", "queries", "width", "height", "shader"),
    },
    "teleop": {
        "the object": ("seed", "partnet_root", "joint", "skip_missing", "root"),
        "the server and its picture": ("host", "port", "width", "height", "cert", "key"),
    },
    "measure": {
        "of files": ("asset", "joint", "columns", "unit_t", "unit_q", "unit_effort", "zero", "reverse", "held_out"),
        "of files, the drive and the asset's uncertainty": (
            "effort",
            "actuator",
            "interpolation",
            "circumstances",
            "inertia_relative",
            "gravity_relative",
        ),
        "of truths, the simulated tracker": ("noise_mm", "noise_deg", "seed", "partnet_root", "urdf", "root"),
    },
}
"""Command to headings and their options. Options under no heading come first."""


def top_help(commands: dict[str, Callable[..., Any]], description: str) -> str:
    """The help of the program: every command with one line."""
    width = _width()
    lines = ["usage: freeart21 COMMAND [OPTIONS]", "", *textwrap.wrap(description, width), "", "commands:"]
    for name, f in commands.items():
        line = (inspect.getdoc(f) or "").partition("\n")[0]
        for end in (r":| \(", ","):
            if len(line) > width - 20:
                line = re.split(end, line)[0] + "."
        lines.append(f"  {name:16}  {line}")
    return "\n".join(
        [
            *lines,
            "",
            "`freeart21 COMMAND --help` lists the options of a command, `freeart21 --version` prints the version.",
        ]
    )


def command_help(name: str, f: Callable[..., Any]) -> str:
    """The help of one command: usage, what it does, and its options with their units and defaults."""
    summary, texts = _docstring(f)
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
        lines += _entry(_positional(p, hints[p.name]).strip("[]"), texts.get(p.name, ""), p.default)
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
                texts.get(option) or _tyro_argument(hint, "help") or "",
                by_name[option].default,
            )
    return "\n".join(lines)


def _entry(left: str, text: str, default: object) -> Iterator[str]:
    """The lines of one option: its flag, then its text in a second column."""
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
    """The text before "Args:", and argument name to its text."""
    summary, _, listed = (inspect.getdoc(f) or "").partition("\nArgs:\n")
    texts: dict[str, str] = {}
    name = ""
    for line in listed.splitlines():
        begins = re.match(r" {4}(\w+): (.*)", line)
        if begins:
            name = begins[1]
            texts[name] = begins[2]
        elif name:
            texts[name] += " " + line.strip()
    return summary.strip(), texts


def _markers(hint: Any) -> tuple[Any, ...]:
    return get_args(hint)[1:] if get_origin(hint) is Annotated else ()


def _tyro_argument(hint: Any, field: str) -> Any:
    """A field of a parameter's `tyro.conf.arg`: its name, metavar or help; None without one."""
    marker = next((m for m in _markers(hint) if hasattr(m, "help_behavior_hint")), None)
    return getattr(marker, field, None)


def _flag(name: str, hint: Any) -> str:
    return "--" + (_tyro_argument(hint, "name") or name).replace("_", "-")


def _positional(p: inspect.Parameter, hint: Any) -> str:
    many = get_origin(get_args(hint)[0]) is tuple
    word = p.name.upper() + ("..." if many else "")
    return word if p.default is inspect.Parameter.empty else f"[{word}]"


def _metavar(hint: Any) -> str:
    """The placeholder of an option's value; empty for a switch."""
    given = _tyro_argument(hint, "metavar")
    if given is not None:
        return str(given)
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
