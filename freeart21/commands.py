"""Commands of the light package: tyro reads each function's signature, and the help its docstring."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import tyro

Positional: Any = tyro.conf.Positional
AsJson = Annotated[bool, tyro.conf.arg(name="json")]


def doctor(as_json: AsJson = False) -> int:
    """Check this machine (Vulkan, GPU, packages), and print how to fix what is missing.

    Args:
        as_json: Print JSON instead of a table.
    """
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from freeart21 import doctor as examination

    findings = examination.examine()
    if as_json:
        print(json.dumps([vars(f) for f in findings], indent=1))
    else:
        table = Table("item", "", "found", title="freeart21 doctor")
        marks = {"ok": "[green]ok[/]", "note": "[dim]note[/]", "missing": "[bold red]missing[/]"}
        for f in findings:
            table.add_row(f.name, marks[f.status], escape(f.detail))
        Console().print(table)
        for f in findings:
            if f.fix:
                print(f"To fix {f.name}: {f.fix}")
    return 1 if any(f.status == "missing" for f in findings) else 0


def objects(as_json: AsJson = False) -> None:
    """List the objects of the catalog: name, category, joint type, size, source.

    Args:
        as_json: Print JSON instead of a table.
    """
    from rich.console import Console
    from rich.table import Table

    from freeart21.catalog import CATALOG

    if as_json:
        print(json.dumps([vars(entry) for entry in CATALOG], indent=1))
        return
    table = Table("name", "category", "joint", "size", "source", title="objects")
    for entry in CATALOG:
        size = "?" if entry.size_m is None else f"{100 * entry.size_m:.0f} cm"
        table.add_row(entry.name, entry.category, entry.joint_type, size, entry.source)
    Console().print(table)


def view(
    path: Annotated[Path, Positional],
    out: Path | None = None,
    truth: Path | None = None,
    sequence: Path | None = None,
    root: Path | None = None,
) -> None:
    """Write a page of a sequence, result, asset, Gaussians file or data folder.

    The page is one file that needs no network.

    Args:
        path: A sequence, result, truth, asset or data folder, a URDF, or a PLY of Gaussians.
        out: The page; NAME.html in the working folder when not given.
        truth: Truth folder to show with a sequence or a result.
        sequence: Sequence folder of a result, for its video.
        root: Folder with all files of a URDF; its own, or its package's, when not given.
    """
    from freeart21.view import write_page

    page = out or Path(f"{path.resolve().name}.html")
    write_page(path, page, truth=truth, sequence=sequence, root=root)
    print(page)
