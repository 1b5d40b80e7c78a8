"""Writes the trust in the underlying reconstruction into asset files, and reads it back."""

from __future__ import annotations

import re
from pathlib import Path

from freeart21.files import checked
from freeart21.files.asset import ASSET_SCHEMA
from freeart21.files.trust_json import trust_from_json
from freeart21.files.urdf import read_comments
from freeart21.reconstruction import Trust, describe_trust

MARK = "freeart21 trust: "
"""Prefix of the comment in URDF and MJCF, and of the documentation in USD."""


def trust_comment(trust: Trust | None) -> str:
    """Text of the comment in URDF and MJCF; XML comments allow no double hyphen."""
    return f" {MARK}{re.sub('-(?=-)', '- ', describe_trust(trust))} "


def read_stated_trust(urdf: Path | None, mjcf: Path | None) -> Trust | None:
    """Trust stated by the files' comments and the asset.json beside them: doubtful when any of them is, None when none
    states it.

    Raises FreeArtError when a file cannot be read.
    """
    found = []
    for file in (urdf, mjcf):
        header = None if file is None else file.parent / "asset.json"
        if header is not None and header.is_file():
            found.append(trust_from_json(checked.read_json(header, ASSET_SCHEMA).get("trust"), header))
        if file is not None and (statement := _read_comment(file)):
            verdict, _, reasons = statement.partition(": ")
            if verdict == "sound":
                found.append(Trust("sound"))
            elif verdict == "doubtful":
                found.append(Trust("doubtful", (reasons,)))
    known = [trust for trust in found if trust is not None]
    return next((trust for trust in known if trust.verdict == "doubtful"), known[0] if known else None)


def _read_comment(file: Path) -> str | None:
    """The text after `MARK` in the first comment that begins with it."""
    return next((text.removeprefix(MARK) for text in read_comments(file) if text.startswith(MARK)), None)
