"""Creates and loads this machine's self-signed TLS certificate.

Browsers allow WebXR only for https pages (or for loopback), so that a headset on the network needs a certificate. A
browser warns of a self-signed one and shows the fingerprint that the terminal printed.
"""

from __future__ import annotations

import contextlib
import hashlib
import ipaddress
import os
import re
import socket
import ssl
import stat
import threading
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import TYPE_CHECKING

from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

if TYPE_CHECKING:
    from cryptography import x509

DAYS = 397
"""Validity, with the day before today (clocks differ): Apple's browsers accept at most 398 days."""
_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_-]{1,63})*\.?")
_PATIENCE_S = 2.0
"""Longest wait for the machine's full name: without a name server the system waits for 5 s and longer."""
_LARGEST = 64 << 10


@dataclass(frozen=True)
class Certificate:
    """A file with a private key and its certificate."""

    path: Path
    """PEM file, readable by its owner only."""
    fingerprint: str
    """SHA-256 of the certificate as browsers show it: 32 pairs of hexadecimal digits, separated by colons."""
    names: tuple[str, ...]
    """Host names and addresses for which it is valid."""

    def context(self) -> ssl.SSLContext:
        """The TLS context of a server with this certificate."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(self.path)
        return context


def default_folder() -> Path:
    """$XDG_STATE_HOME/freeart21/teleop, or ~/.local/state/freeart21/teleop."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "freeart21" / "teleop"


def load_certificate(
    host: str, names: tuple[str, ...] = (), folder: Path | None = None, now: datetime | None = None
) -> Certificate:
    """The certificate stored in `folder`, or a new one.

    A new one is made when there is none, when it expires within a day, when it lacks a name or address of this machine,
    or when others could have read its key. Raises FreeArtError and CannotWrite.
    """
    folder = default_folder() if folder is None else folder
    now = datetime.now(timezone.utc) if now is None else now
    wanted = tuple(dict.fromkeys([*find_machine_names(host), *map(normalise_host, names)]))
    path = _private_folder(folder) / "key-and-certificate.pem"
    stored = _read_certificate(path)
    if stored is not None:
        left = stored.not_valid_after_utc - now
        if set(wanted) <= set(_certificate_names(stored)) and timedelta(days=1) < left <= timedelta(days=DAYS):
            return Certificate(path, _fingerprint(stored), _certificate_names(stored))
    certificate, pem = _new_certificate(wanted, now)
    atomic.write_bytes(path, pem, mode=0o600)
    return Certificate(path, _fingerprint(certificate), _certificate_names(certificate))


def find_machine_names(host: str) -> tuple[str, ...]:
    """Names and addresses of this machine, with `host` unless it stands for all addresses."""
    own = socket.gethostname()
    found = ["localhost", own, _find_full_name()]
    if "." not in own:
        found.append(f"{own}.local")  # its name on a network without name servers (mDNS)
    found = [name.rstrip(".").lower() for name in found if _NAME.fullmatch(name)]
    given = normalise_host(host)
    return tuple(dict.fromkeys([*([] if is_unspecified(host) else [given]), *found, *local_addresses()]))


def is_unspecified(host: str) -> bool:
    """Whether `host` stands for all addresses of this machine."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_unspecified
    return False


def normalise_host(name: str) -> str:
    """Normalise an address or host name; FreeArtError when it is neither."""
    with contextlib.suppress(ValueError):
        return str(ipaddress.ip_address(name))
    if not _NAME.fullmatch(name):
        raise FreeArtError(
            f"host {name[:60]!r} is neither an address nor a host name, expected such as 192.168.1.7 or my-desk"
        )
    return name.rstrip(".").lower()


def local_addresses() -> tuple[str, ...]:
    """Addresses of this machine: loopback first, then that of outgoing connections; link-local ones are left out."""
    found = ["127.0.0.1", "::1"]
    for family, far in (
        (socket.AF_INET, "192.0.2.1"),
        (socket.AF_INET6, "2001:db8::1"),
    ):  # documentation addresses; nothing is sent
        with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((far, 9))
            found.append(probe.getsockname()[0])
    found += [*_interface_addresses()]
    with contextlib.suppress(OSError):
        found += [str(entry[4][0]) for entry in socket.getaddrinfo(socket.gethostname(), None)]
    good = [address for text in found if not (address := ipaddress.ip_address(text.partition("%")[0])).is_link_local]
    return tuple(dict.fromkeys(str(address) for address in good if not address.is_unspecified))


def _interface_addresses() -> list[str]:
    """The first IPv4 address of each network interface (Linux only)."""
    try:
        import fcntl
    except ImportError:
        return []
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # it has none
                request = name.encode()[:15].ljust(256, b"\0")
                reply = fcntl.ioctl(any_socket.fileno(), 0x8915, request)  # SIOCGIFADDR
                found.append(socket.inet_ntoa(reply[20:24]))
    return found


def _find_full_name() -> str:
    found: list[str] = []
    asking = threading.Thread(target=lambda: found.append(socket.getfqdn()), daemon=True)
    asking.start()
    asking.join(_PATIENCE_S)
    return found[0] if found else ""


def _private_folder(folder: Path) -> Path:
    """Create `folder` if needed; it must belong to this user, and nobody else may read it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        facts = folder.lstat()
        if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.getuid():
            raise FreeArtError(f"{folder} is not a folder of this user: no key is stored in it; move it away")
        folder.chmod(0o700)
    except OSError as error:
        raise atomic.cannot_write(folder, error) from error
    return folder


def _read_certificate(path: Path) -> x509.Certificate | None:
    """The certificate in `path`; None when there is none, its key does not match, or others may read it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import serialization

    try:
        facts = path.lstat()
        mine = stat.S_ISREG(facts.st_mode) and facts.st_uid == os.getuid() and not facts.st_mode & 0o077
        if not mine or facts.st_size > _LARGEST:
            return None
        data = checked.read_bytes(path, _LARGEST)
        certificate = x509.load_pem_x509_certificate(data)
        key = serialization.load_pem_private_key(data, None)
        certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except (FreeArtError, OSError, ValueError, TypeError, x509.ExtensionNotFound):
        return None
    return certificate if certificate.public_key() == key.public_key() else None


def _new_certificate(names: tuple[str, ...], now: datetime) -> tuple[x509.Certificate, bytes]:
    """A new self-signed certificate, and the PEM of its key and itself."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "FreeArt-21 teleoperation on this machine")])
    began = (now - timedelta(days=1)).replace(microsecond=0)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(began)
        .not_valid_after(began + timedelta(days=DAYS))
        .add_extension(x509.SubjectAlternativeName([_general_name(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.KeyUsage(True, *[False] * 8), critical=True)  # digital signature only
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return certificate, private + certificate.public_bytes(serialization.Encoding.PEM)


def _general_name(name: str) -> x509.GeneralName:
    from cryptography import x509

    with contextlib.suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(name))
    return x509.DNSName(name)


def _certificate_names(certificate: x509.Certificate) -> tuple[str, ...]:
    from cryptography import x509

    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return tuple(str(name.value) for name in found)


def _fingerprint(certificate: x509.Certificate) -> str:
    from cryptography.hazmat.primitives.serialization import Encoding

    digest = hashlib.sha256(certificate.public_bytes(Encoding.DER)).digest()
    return ":".join(f"{byte:02X}" for byte in digest)
