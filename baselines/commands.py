"""The command line of a baseline: errors are one line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from freeart21.errors import FreeArtError


def run_command(main: Callable[..., Any]) -> None:
    """Run `main` with the arguments of the command line: Paths by position, the others as options."""
    import tyro

    try:
        tyro.cli(main, config=(tyro.conf.PositionalRequiredArgs,))
    except FreeArtError as error:
        raise SystemExit(str(error)) from error
