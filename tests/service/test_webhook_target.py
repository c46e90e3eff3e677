"""Where an alarm may go: to the address that was meant, checked each time, and nowhere else."""

import ipaddress
import json
import socket
import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

from cellcal.service.export.webhook_sender import signed_headers
from cellcal.service.export.webhook_target import WebhookError, deliver_event, refuse_address, target_of
from tests.service.loopback_site import free_port
from tests.service.webhook_receiver import SECRET, WebhookReceiver, webhook_table

BAD_URLS = [
    *(
        "http://example.com/",
        "ftp://127.0.0.1/",
        "https://",
        "https://a:b@example.com/",
        "file:///etc/passwd",
    ),
    *(
        "https://x/#y",
        "http://127.0.0.1.evil.example/",
        "http://[::ffff:10.0.0.1]/",
        "https://example.com:99999/",
    ),
    *("https://a b/", "https://x/\r\nA: b"),
]


@pytest.mark.parametrize("url", BAD_URLS)
def test_an_address_that_is_none_is_refused(tmp_path: Path, url: str) -> None:
    with pytest.raises(WebhookError):
        target_of(webhook_table(url, tmp_path))


# name, address, allowed by default, allowed in a private network
ADDRESSES = [
    ("example.com", "93.184.216.34", True, True),
    ("example.com", "2606:2800:220:1::1", True, True),
    ("example.com", "127.0.0.1", False, False),  # a name that any owner may let point here
    ("example.com", "::1", False, False),
    ("example.com", "::ffff:127.0.0.1", False, False),
    ("example.com", "169.254.169.254", False, False),  # metadata of clouds
    ("example.com", "::ffff:169.254.169.254", False, False),
    ("example.com", "fe80::1", False, False),
    ("example.com", "0.0.0.0", False, False),
    ("example.com", "::", False, False),
    ("example.com", "224.0.0.1", False, False),
    ("example.com", "ff02::1", False, False),
    ("example.com", "255.255.255.255", False, False),
    ("example.com", "10.1.2.3", False, True),
    ("example.com", "192.168.0.9", False, True),
    ("example.com", "100.64.0.1", False, True),
    ("example.com", "fd00::1", False, True),
    ("example.com", "64:ff9b::a01:203", False, False),  # 10.1.2.3, translated
    ("example.com", "2002:a01:203::1", False, True),
    ("localhost", "127.0.0.1", True, True),
    ("localhost", "93.184.216.34", False, False),
    ("127.0.0.1", "127.0.0.1", True, True),
]


@pytest.mark.parametrize(("host", "address", "public", "private"), ADDRESSES)
def test_only_an_address_that_was_meant_is_reached(
    tmp_path: Path, host: str, address: str, public: bool, private: bool
) -> None:
    for in_plant, allowed in ((False, public), (True, private)):
        target = target_of(webhook_table(f"https://{host}/", tmp_path, private_network=in_plant))
        if allowed:
            refuse_address(ipaddress.ip_address(address), target)
        else:
            with pytest.raises(WebhookError, match="no event is sent there"):
                refuse_address(ipaddress.ip_address(address), target)


def test_an_undeclared_local_address_is_not_contacted(tmp_path: Path) -> None:
    receiver = WebhookReceiver(free_port())
    with receiver.open_receiver():
        own_name = socket.gethostname()
        target = target_of(webhook_table(f"https://{own_name}.localdomain:{receiver.port}/", tmp_path))
        with pytest.raises(WebhookError):
            deliver_event(target, b"{}", signed_headers(SECRET, "evt_1", b"{}", 0.0))
    assert receiver.messages == []


def test_a_proxy_of_the_environment_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    receiver = WebhookReceiver(free_port())
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    monkeypatch.setenv("ALL_PROXY", "http://127.0.0.1:9")
    body = json.dumps({"type": "test", "data": {"code": "x"}}).encode()
    with receiver.open_receiver():
        target = target_of(webhook_table(f"http://127.0.0.1:{receiver.port}/", tmp_path))
        assert deliver_event(target, body, signed_headers(SECRET, "evt_1", body, 0.0)) == 204


def make_server_certificate(folder: Path) -> tuple[ssl.SSLContext, Path]:
    key = ec.generate_private_key(ec.SECP256R1())
    name, now = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "receiver")]), datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(hours=1))
        .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
        .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    path, pem = folder / "ca.pem", serialization.Encoding.PEM
    path.write_bytes(made.public_bytes(pem))
    private = key.private_bytes(pem, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    (folder / "key.pem").write_bytes(private)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(path, folder / "key.pem")
    return context, path


def test_tls_is_checked_against_name_and_issuer(tmp_path: Path) -> None:
    context, ca_file = make_server_certificate(tmp_path)
    receiver = WebhookReceiver(free_port(), context=context)
    body = json.dumps({"type": "test", "data": {"code": "x"}}).encode()
    headers = signed_headers(SECRET, "evt_1", body, 0.0)
    with receiver.open_receiver():
        good = webhook_table(f"https://localhost:{receiver.port}/", tmp_path, ca_file=ca_file)
        assert deliver_event(target_of(good), body, headers) == 204
        for url, ca in ((f"https://127.0.0.1:{receiver.port}/", ca_file), (good.url, None)):
            with pytest.raises(WebhookError, match="does not take the event"):
                deliver_event(target_of(webhook_table(url, tmp_path, ca_file=ca)), body, headers)
    assert len(receiver.messages) == 1
