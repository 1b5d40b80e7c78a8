"""Whether to trust the reconstruction behind an asset: written into each of its files, and read back from them."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

from freeart21.files import checked
from freeart21.files.asset import ASSET_SCHEMA
from freeart21.files.trust_json import trust_from_json
from freeart21.files.urdf import read_xml
from freeart21.reconstruction import Trust, describe_trust

MARK = "freeart21 trust: "
"""Begin of the comment in URDF and MJCF, and of the documentation in USD."""


def trust_comment(trust: Trust | None) -> str:
    """The text of the comment that URDF and MJCF carry. XML allows no two hyphens in a row in it."""
    return f" {MARK}{re.sub('-(?=-)', '- ', describe_trust(trust))} "


def stated_trust(urdf: Path | None, mjcf: Path | None) -> Trust | None:
    """What the asset.json beside these files and their comments state; doubtful when one of them does.

    None when nothing is stated. Raises FreeArtError when a file cannot be read.
    """
    found = []
    for file in (urdf, mjcf):
        header = None if file is None else file.parent / "asset.json"
        if header is not None and header.is_file():
            found.append(trust_from_json(checked.read_json(header, ASSET_SCHEMA).get("trust"), header))
        if file is not None and (said := _commented(file)):
            verdict, _, reasons = said.partition(": ")
            if verdict == "sound":
                found.append(Trust("sound"))
            elif verdict == "doubtful":
                found.append(Trust("doubtful", (reasons,)))
    known = [trust for trust in found if trust is not None]
    return next((trust for trust in known if trust.verdict == "doubtful"), known[0] if known else None)


def _commented(file: Path) -> str | None:
    """What follows `MARK` in the first comment that begins with it."""
    root = read_xml(file, comments=True)
    texts = ((element.text or "").strip() for element in root.iter() if element.tag is ET.Comment)
    return next((text.removeprefix(MARK) for text in texts if text.startswith(MARK)), None)
