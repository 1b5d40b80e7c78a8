"""Readers of the data in pages, for tests: what the scripts read."""

from __future__ import annotations

import base64
import json
import zlib
from html.parser import HTMLParser
from typing import Any

import numpy as np
from numpy.typing import NDArray

VOID = {"meta", "link", "img", "br", "input", "hr"}
DTYPES = {"f32": "<f4", "u32": "<u4", "u16": "<u2", "u8": "u1"}


class Parsed(HTMLParser):
    """Elements, attributes and scripts of a page; fails on elements that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.scripts: list[tuple[bool, str]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((dict(attrs).get("type") == "application/json", ""))

    def handle_startendtag(self, tag: str, attrs: list) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)

    @property
    def data(self) -> list[dict]:
        return [json.loads(text) for is_data, text in self.scripts if is_data]


def extract_array(data: dict[str, Any]) -> NDArray[Any]:
    """The array behind the output of `embed_array` or `embed_points`."""
    array = np.frombuffer(base64.b64decode(data["base64"]), DTYPES[data["dtype"]]).reshape(data["shape"])
    return data["low"] + array * np.asarray(data["steps"]) if "low" in data else array


def read_varints(data: bytes) -> NDArray[np.int64]:
    """The integers (n,) behind the output of `varints`."""
    found, value, shift = [], 0, 0
    for byte in data:
        value |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            found.append((value >> 1) ^ -(value & 1))
            value = shift = 0
    return np.array(found, np.int64)


def read_script(script: str) -> tuple[dict[str, Any], bytes]:
    """Header and bytes behind the output of `Packed.script`."""
    body = zlib.decompress(base64.b64decode(script.split('"')[1]))
    length = int.from_bytes(body[:4], "little")
    return json.loads(body[4 : 4 + length]), body[4 + length :]
