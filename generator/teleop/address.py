"""Addresses of the page, with the token, and a QR code of one for the camera of a headset or telephone."""

from __future__ import annotations

import ipaddress
import socket
from urllib.parse import quote

from generator.teleop.certificate import is_unspecified, local_addresses

QUIET = 4
"""Margin of a QR code, modules (ISO/IEC 18004)."""


def is_loopback(host: str) -> bool:
    """Whether only this machine can reach `host`."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host.rstrip(".").lower() == "localhost"


def addresses(host: str, port: int, token: str) -> tuple[str, ...]:
    """Addresses of the page at `host`, the best first; with https unless it is loopback."""
    if is_loopback(host):
        return (_address("http", host, port, token),)
    hosts = [host]
    if is_unspecified(host):
        v4_only = ipaddress.ip_address(host).version == 4
        reached = [a for a in map(ipaddress.ip_address, local_addresses()) if not a.is_loopback]
        hosts = [str(a) for a in reached if a.version == 4 or not v4_only] + [socket.gethostname()]
    return tuple(_address("https", each, port, token) for each in hosts)


def qr_code(text: str, colour: bool = True) -> str:
    """A QR code of `text` in half blocks, two modules a character; needs the package qrcode.

    With `colour` it is black on white whatever the terminal's colours are, else it is drawn in the terminal's.
    """
    import qrcode

    code = qrcode.QRCode(error_correction=qrcode.constants.ERROR_CORRECT_L, border=QUIET)
    code.add_data(text)
    code.make()
    rows = code.get_matrix()
    if len(rows) % 2:
        rows.append([False] * len(rows[0]))
    blocks = {(False, False): " ", (True, False): "\N{UPPER HALF BLOCK}", (False, True): "\N{LOWER HALF BLOCK}"}
    lines = []
    for upper, lower in zip(rows[::2], rows[1::2], strict=True):
        line = "".join(blocks.get((a, b), "\N{FULL BLOCK}") for a, b in zip(upper, lower, strict=True))
        lines.append(f"\x1b[30;107m{line}\x1b[0m" if colour else line)
    return "\n".join(lines)


def _address(scheme: str, host: str, port: int, token: str) -> str:
    shown = f"[{host}]" if ":" in host else host
    return f"{scheme}://{shown}:{port}/?token={quote(token, safe='')}"
