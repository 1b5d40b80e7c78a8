"""A machine's own certificate by real handshakes, and addresses as a terminal shows them."""

from __future__ import annotations

import hashlib
import ipaddress
import os
import socket
import ssl
import stat
import threading
from datetime import datetime, timedelta, timezone
from pathlib import Path

import cv2
import numpy as np
import pytest

from freeart21.errors import FreeArtError

pytest.importorskip("cryptography", reason="the extra teleop is not installed")
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from generator.teleop import address, certificate
from generator.teleop.certificate import Certificate, load_certificate

HOST = "192.0.2.77"


def parsed(own: Certificate) -> x509.Certificate:
    return x509.load_pem_x509_certificate(own.path.read_bytes())


def greeted(context: ssl.SSLContext, client: ssl.SSLContext, name: str) -> bytes:
    """What a client that asks for `name` gets as certificate, in DER; SSLError when it does not believe it."""
    listening = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        there, _ = listening.accept()
        try:
            with context.wrap_socket(there, server_side=True) as secure:
                secure.recv(1)
        except OSError:
            there.close()

    serving = threading.Thread(target=serve)
    serving.start()
    try:
        with (
            socket.create_connection(listening.getsockname()) as raw,
            client.wrap_socket(raw, server_hostname=name) as secure,
        ):
            secure.sendall(b"x")
            return secure.getpeercert(binary_form=True) or b""
    finally:
        serving.join()
        listening.close()


def believer(own: Certificate, path: Path) -> ssl.SSLContext:
    """A client that trusts this certificate alone, and checks names."""
    path.write_bytes(parsed(own).public_bytes(serialization.Encoding.PEM))
    return ssl.create_default_context(cafile=str(path))


def test_a_handshake_proves_every_name_and_the_printed_fingerprint(tmp_path: Path) -> None:
    own = load_certificate(HOST, ("my-desk.example",), tmp_path / "own")
    client = believer(own, tmp_path / "trusted.pem")
    assert {"localhost", "127.0.0.1", "::1", HOST, "my-desk.example"} <= set(own.names)
    assert set(certificate.local_addresses()) <= set(own.names) and socket.gethostname().lower() in own.names
    for name in own.names:
        der = greeted(own.context(), client, name)
        digest = hashlib.sha256(der).hexdigest().upper()
        assert own.fingerprint == ":".join(digest[i : i + 2] for i in range(0, 64, 2))
    for wrong in ("192.0.2.78", "another.example"):
        with pytest.raises(ssl.SSLCertVerificationError, match="mismatch|not valid for"):
            greeted(own.context(), client, wrong)
    with pytest.raises(ssl.SSLCertVerificationError, match="self-signed"):
        greeted(own.context(), ssl.create_default_context(), "localhost")


def test_it_is_a_p256_leaf_for_servers_of_397_days(tmp_path: Path) -> None:
    now = datetime.now(timezone.utc)
    found = parsed(load_certificate(HOST, folder=tmp_path / "own", now=now))
    assert found.not_valid_after_utc - found.not_valid_before_utc == timedelta(days=397)
    assert found.not_valid_before_utc < now - timedelta(hours=23)
    assert isinstance(found.public_key(), ec.EllipticCurvePublicKey)
    assert isinstance(found.public_key().curve, ec.SECP256R1)
    extensions = found.extensions
    assert not extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    assert extensions.get_extension_for_class(x509.KeyUsage).value.digital_signature
    names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert ipaddress.ip_address(HOST) in names.get_values_for_type(x509.IPAddress)
    assert "localhost" in names.get_values_for_type(x509.DNSName)


def test_the_key_is_its_owner_s_alone_and_no_two_machines_share_one(tmp_path: Path) -> None:
    old = os.umask(0)
    try:
        own = load_certificate(HOST, folder=tmp_path / "a" / "own")
    finally:
        os.umask(old)
    assert stat.S_IMODE(own.path.stat().st_mode) == 0o600 and stat.S_IMODE(own.path.parent.stat().st_mode) == 0o700
    assert [p.name for p in own.path.parent.iterdir()] == [own.path.name]
    other = load_certificate(HOST, folder=tmp_path / "b" / "own")
    assert parsed(own).public_key() != parsed(other).public_key()
    repository = Path(certificate.__file__).resolve().parents[2]
    shipped = [p for room in ("generator", "freeart21", "docs", "tests") for p in (repository / room).rglob("*.pem")]
    assert not shipped


def test_it_is_kept_while_it_is_good(tmp_path: Path) -> None:
    first, folder = load_certificate(HOST, folder=tmp_path), tmp_path
    data = first.path.read_bytes()
    assert load_certificate(HOST, folder=folder) == first and load_certificate("127.0.0.1", folder=folder) == first
    assert isinstance(load_certificate(HOST, (), folder).context(), ssl.SSLContext)
    assert first.path.read_bytes() == data


def _expires(path: Path) -> timedelta:
    return timedelta(days=395.5)  # less than a day is left of it


def _readable(path: Path) -> None:
    path.chmod(0o640)


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-90])


def _another_key(path: Path) -> None:
    text = path.read_text()
    key = ec.generate_private_key(ec.SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    path.write_text(key.decode() + text[text.index("-----BEGIN CERTIFICATE") :])


def _linked(path: Path) -> None:
    path.rename(path.parent / "elsewhere.pem")
    path.symlink_to(path.parent / "elsewhere.pem")


def _empty(path: Path) -> None:
    path.write_bytes(b"")


@pytest.mark.parametrize("spoil", [_expires, _readable, _cut, _another_key, _linked, _empty])
def test_it_is_made_anew_when_it_is_good_no_more(tmp_path: Path, spoil) -> None:
    first = load_certificate(HOST, folder=tmp_path)
    later = spoil(first.path) or timedelta()
    second = load_certificate(HOST, folder=tmp_path, now=datetime.now(timezone.utc) + later)
    assert second.fingerprint != first.fingerprint
    assert stat.S_IMODE(second.path.lstat().st_mode) == 0o600 and not second.path.is_symlink()
    assert load_certificate(HOST, folder=tmp_path, now=datetime.now(timezone.utc) + later) == second


def test_a_new_name_makes_a_new_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = load_certificate(HOST, folder=tmp_path)
    second = load_certificate("192.0.2.78", folder=tmp_path)
    assert second.fingerprint != first.fingerprint and "192.0.2.78" in second.names
    monkeypatch.setattr(certificate, "local_addresses", lambda: ("127.0.0.1", "192.0.2.99"))
    assert "192.0.2.99" in load_certificate("0.0.0.0", folder=tmp_path).names


@pytest.mark.parametrize("host", ["", "a b", "x/y", "*", "-a", "a" * 300, "1.2.3.4:80", "exam\nple", "größe"])
def test_a_host_that_is_none_is_refused_in_a_line(tmp_path: Path, host: str) -> None:
    with pytest.raises(FreeArtError, match="is neither an address nor a host name") as caught:
        load_certificate(host, folder=tmp_path / "own")
    assert not (tmp_path / "own").exists()
    assert "\n" not in str(caught.value)


def test_a_folder_that_is_none_or_a_link_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(FreeArtError, match="cannot write"):
        load_certificate(HOST, folder=tmp_path / "file")
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there")
    with pytest.raises(FreeArtError, match="is not a folder of this user"):
        load_certificate(HOST, folder=tmp_path / "link")
    assert not list((tmp_path / "there").iterdir())


def test_a_name_server_that_does_not_answer_does_not_hold_things_up(monkeypatch: pytest.MonkeyPatch) -> None:
    answer = threading.Event()
    monkeypatch.setattr(certificate, "_PATIENCE_S", 0.01)
    monkeypatch.setattr(socket, "getfqdn", lambda: answer.wait(60) and "never")
    assert "never" not in certificate.find_machine_names("0.0.0.0")
    answer.set()


# --- addresses --------------------------------------------------------------------------------------------------------


def test_the_machine_itself_is_http_and_all_else_https(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(address, "local_addresses", lambda: ("127.0.0.1", "::1", "192.0.2.5", "2001:db8::5"))
    monkeypatch.setattr(socket, "gethostname", lambda: "desk")
    assert address.addresses("127.0.0.1", 8021, "a_-b") == ("http://127.0.0.1:8021/?token=a_-b",)
    assert address.addresses("::1", 8021, "t") == ("http://[::1]:8021/?token=t",)
    assert address.addresses("localhost", 1, "t") == ("http://localhost:1/?token=t",)
    assert address.addresses("192.0.2.9", 8021, "t") == ("https://192.0.2.9:8021/?token=t",)
    both = "https://192.0.2.5:8021/?token=t", "https://desk:8021/?token=t"
    assert address.addresses("0.0.0.0", 8021, "t") == both
    assert address.addresses("::", 8021, "t") == (both[0], "https://[2001:db8::5]:8021/?token=t", both[1])
    assert [address.is_loopback(h) for h in ("127.0.0.9", "::1", "localhost", "0.0.0.0", "desk")] == [True] * 3 + [
        False
    ] * 2


@pytest.mark.parametrize("colour", [True, False])
def test_the_code_in_the_terminal_is_read_by_a_camera(colour: bool) -> None:
    pytest.importorskip("qrcode", reason="the extra teleop is not installed")
    text = "https://192.168.100.123:8021/?token=abcdefghij_-ABCDEFGHIJ"
    lines = address.qr_code(text, colour).split("\n")
    if colour:
        assert all(line.startswith("\x1b[30;107m") and line.endswith("\x1b[0m") for line in lines)
        lines = [line.removeprefix("\x1b[30;107m").removesuffix("\x1b[0m") for line in lines]
    assert len({len(line) for line in lines}) == 1 and len(lines[0]) <= 60
    halves = {" ": (0, 0), "\N{UPPER HALF BLOCK}": (1, 0), "\N{LOWER HALF BLOCK}": (0, 1), "\N{FULL BLOCK}": (1, 1)}
    dark = np.array([[halves[c][k] for c in line] for line in lines for k in (0, 1)], np.uint8)
    picture = np.kron(255 * (1 - dark), np.ones((8, 8), np.uint8)).astype(np.uint8)
    assert cv2.QRCodeDetector().detectAndDecode(picture)[0] == text
