"""camera.json, the faults of a camera: written by `gap`, read by `record --camera`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

from freeart21.camera_faults import CameraFaults
from freeart21.files import atomic, checked
from freeart21.files.json_record import read_record

SCHEMA = "freeart21/camera-faults/1"


def faults_json(faults: CameraFaults) -> dict[str, Any]:
    """The JSON object of the file: only fields that differ from a perfect camera."""
    plain = asdict(CameraFaults())
    return {"schema": SCHEMA} | {name: value for name, value in asdict(faults).items() if value != plain[name]}


def write_camera_faults(path: Path, faults: CameraFaults) -> None:
    """Write the file, whole or not at all."""
    atomic.write_json(path, faults_json(faults))


def read_camera_faults(path: Path) -> CameraFaults:
    """The faults in a file; FreeArtError names a field that is unknown, no number or out of bounds."""
    data = checked.read_json(path, SCHEMA, checked.ANYWHERE)
    del data["schema"]
    with checked.naming(path):
        return read_record(CameraFaults, data, "camera faults")
