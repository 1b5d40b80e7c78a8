"""A certificate of this machine's own, made on the spot: nothing is shipped, and no key is anybody else's.

Browsers give WebXR to pages of https alone (or of the machine itself), so that a headset on the network needs one. It
is signed by itself: a browser warns of it, and shows the fingerprint that the terminal has printed.
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
"""Of a certificate, the day before today with them (clocks differ): browsers of Apple take 398 at most."""
_NAME = re.compile(r"(?=.{1,253}$)[A-Za-z0-9]([A-Za-z0-9_-]{0,62})(\.[A-Za-z0-9_-]{1,63})*\.?")
_PATIENCE_S = 2.0
"""For the machine's full name: where no name server answers, the system asks for 5 s and longer."""
_LARGEST = 64 << 10


@dataclass(frozen=True)
class Certificate:
    """One file that holds a private key and the certificate of it."""

    path: Path
    """PEM, readable by its owner alone."""
    fingerprint: str
    """SHA-256 of the certificate, as browsers show it: 32 pairs of hexadecimal digits, colons between."""
    names: tuple[str, ...]
    """Host names and addresses that it is good for."""

    def context(self) -> ssl.SSLContext:
        """What a server speaks TLS by."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.minimum_version = ssl.TLSVersion.TLSv1_2
        context.load_cert_chain(self.path)
        return context


def server_context(host: str, names: tuple[str, ...] = (), folder: Path | None = None) -> ssl.SSLContext:
    """The TLS context of a server at `host`; `names` are further names that it is called by."""
    return own_certificate(host, names, folder).context()


def default_folder() -> Path:
    """$XDG_STATE_HOME/freeart21/teleop, or ~/.local/state/freeart21/teleop."""
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "freeart21" / "teleop"


def own_certificate(
    host: str, names: tuple[str, ...] = (), folder: Path | None = None, now: datetime | None = None
) -> Certificate:
    """The certificate kept in `folder`, or a new one.

    New, where none is kept, where a day or less is left of it, where this machine has a name or an address that it
    lacks, or where others could have read its key. Raises FreeArtError, and CannotWrite.
    """
    folder = default_folder() if folder is None else folder
    now = datetime.now(timezone.utc) if now is None else now
    wanted = tuple(dict.fromkeys([*machine_names(host), *map(usual_host, names)]))
    path = _private(folder) / "key-and-certificate.pem"
    kept = _kept(path)
    if kept is not None:
        left = kept.not_valid_after_utc - now
        if set(wanted) <= set(_names_in(kept)) and timedelta(days=1) < left <= timedelta(days=DAYS):
            return Certificate(path, _fingerprint(kept), _names_in(kept))
    made, pem = _made(wanted, now)
    atomic.write_bytes(path, pem, mode=0o600)
    return Certificate(path, _fingerprint(made), _names_in(made))


def machine_names(host: str) -> tuple[str, ...]:
    """Names and addresses of this machine, and `host` where it is one rather than all of them."""
    own = socket.gethostname()
    found = ["localhost", own, _full_name()]
    if "." not in own:
        found.append(f"{own}.local")  # by which it is known on a network without name servers
    found = [name.rstrip(".").lower() for name in found if _NAME.fullmatch(name)]
    given = usual_host(host)
    return tuple(dict.fromkeys([*([] if is_any(host) else [given]), *found, *local_addresses()]))


def is_any(host: str) -> bool:
    """True where `host` stands for all of this machine's addresses."""
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_unspecified
    return False


def usual_host(name: str) -> str:
    """An address or a host's name in its usual spelling; FreeArtError where it is neither."""
    with contextlib.suppress(ValueError):
        return str(ipaddress.ip_address(name))
    if not _NAME.fullmatch(name):
        raise FreeArtError(
            f"host {name[:60]!r} is no address and no host's name: expected such as 192.168.1.7, 0.0.0.0 or my-desk"
        )
    return name.rstrip(".").lower()


def local_addresses() -> tuple[str, ...]:
    """Addresses of this machine, loopback first, then the one that it reaches others from; links' own are left out."""
    found = ["127.0.0.1", "::1"]
    for family, far in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):  # nobody's; nothing is sent
        with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as probe:
            probe.connect((far, 9))
            found.append(probe.getsockname()[0])
    found += [*_of_interfaces()]
    with contextlib.suppress(OSError):
        found += [str(entry[4][0]) for entry in socket.getaddrinfo(socket.gethostname(), None)]
    good = [address for text in found if not (address := ipaddress.ip_address(text.partition("%")[0])).is_link_local]
    return tuple(dict.fromkeys(str(address) for address in good if not address.is_unspecified))


def _of_interfaces() -> list[str]:
    """The first IPv4 address of each network interface, where the system is Linux."""
    try:
        import fcntl
    except ImportError:
        return []
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        for _, name in socket.if_nameindex():
            with contextlib.suppress(OSError):  # it has none
                asked = name.encode()[:15].ljust(256, b"\0")
                reply = fcntl.ioctl(any_socket.fileno(), 0x8915, asked)  # SIOCGIFADDR
                found.append(socket.inet_ntoa(reply[20:24]))
    return found


def _full_name() -> str:
    found: list[str] = []
    asking = threading.Thread(target=lambda: found.append(socket.getfqdn()), daemon=True)
    asking.start()
    asking.join(_PATIENCE_S)
    return found[0] if found else ""


def _private(folder: Path) -> Path:
    """`folder`, made where it is missing: a folder of this user's that nobody else looks into."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        facts = folder.lstat()
        if not stat.S_ISDIR(facts.st_mode) or facts.st_uid != os.getuid():
            raise FreeArtError(f"{folder} is not a folder of this user's: no key is kept in it; move it away")
        folder.chmod(0o700)
    except OSError as error:
        raise atomic.cannot_write(folder, error) from error
    return folder


def _kept(path: Path) -> x509.Certificate | None:
    """The certificate in `path`, where the key beside it is its own and nobody else's."""
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


def _made(names: tuple[str, ...], now: datetime) -> tuple[x509.Certificate, bytes]:
    """A new certificate that signs itself, and the PEM of its key and itself."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "FreeArt-21 teleoperation on this machine")])
    began = (now - timedelta(days=1)).replace(microsecond=0)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(began)
        .not_valid_after(began + timedelta(days=DAYS))
        .add_extension(x509.SubjectAlternativeName([_general(name) for name in names]), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.KeyUsage(True, *[False] * 8), critical=True)  # it signs, and does nothing else
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    return made, private + made.public_bytes(serialization.Encoding.PEM)


def _general(name: str) -> x509.GeneralName:
    from cryptography import x509

    with contextlib.suppress(ValueError):
        return x509.IPAddress(ipaddress.ip_address(name))
    return x509.DNSName(name)


def _names_in(certificate: x509.Certificate) -> tuple[str, ...]:
    from cryptography import x509

    found = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return tuple(str(name.value) for name in found)


def _fingerprint(certificate: x509.Certificate) -> str:
    from cryptography.hazmat.primitives.serialization import Encoding

    digest = hashlib.sha256(certificate.public_bytes(Encoding.DER)).digest()
    return ":".join(f"{byte:02X}" for byte in digest)
