"""Reads and writes certificate.json of an asset."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from freeart21.certificate import Certificate
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record

FILE = "certificate.json"
SCHEMA = "freeart21/certificate/1"


def write_certificate(folder: Path, certificate: Certificate) -> None:
    """Write certificate.json into an asset's folder."""
    atomic.write_json(folder / FILE, {"schema": SCHEMA, **asdict(certificate)})


def read_certificate(folder: Path) -> Certificate | None:
    """The certificate in an asset's folder, None without one; raises FreeArtError when it is invalid."""
    path = folder / FILE
    if not checked.is_there(path):
        return None
    data = {key: value for key, value in checked.read_json(path, SCHEMA).items() if key != "schema"}
    return read_record(Certificate, data, str(path))
