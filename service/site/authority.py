"""The site's own certificate authority: keys and certificates for mutual TLS, as plain files.

Elliptic keys (P-256), because every TLS library takes them. Only the router's certificate may serve: a cell's cannot
play the router. Private keys are written for their owner only and never over another.
"""

import ipaddress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from cellcal.calibration.documents.plain_files import read_plain_bytes
from cellcal.service.files import create_file
from cellcal.service.site.keys import SiteError

AUTHORITY_DAYS, LEAF_DAYS = 3650, 1095
_EARLY = timedelta(hours=1)  # clocks of cells differ
_OWN_ONLY = 0o600


@dataclass(frozen=True, slots=True)
class SiteAuthority:
    """The authority that signs the site's certificates."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate

    @property
    def certificate_pem(self) -> bytes:
        """The certificate that all parts of the site trust."""
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    def issue_certificate(self, name: str, folder: Path, *, serves: str = "") -> None:
        """Write ``<name>.key`` and ``<name>.pem`` for one part of the site; ``serves`` is a router's host."""
        key = ec.generate_private_key(ec.SECP256R1())
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH] + [ExtendedKeyUsageOID.SERVER_AUTH] * bool(serves)
        certificate = (
            _certificate_builder(name, self.certificate.subject, key, LEAF_DAYS)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
            .add_extension(x509.SubjectAlternativeName([_alternative_name(serves or name)]), critical=False)
            .sign(self.key, hashes.SHA256())
        )
        write_new(folder / f"{name}.key", _pem_of(key), _OWN_ONLY)
        write_new(folder / f"{name}.pem", certificate.public_bytes(serialization.Encoding.PEM))


def new_authority(site: str, folder: Path) -> SiteAuthority:
    """Make the site's authority and write ``ca.key`` and ``ca.pem``."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = f"cellcal site {site}"
    usage = dict.fromkeys(_USAGES, False) | {"key_cert_sign": True, "crl_sign": True}
    certificate = (
        _certificate_builder(name, _common_name(name), key, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(x509.KeyUsage(**usage), critical=True)
        .sign(key, hashes.SHA256())
    )
    authority = SiteAuthority(key, certificate)
    write_new(folder / "ca.key", _pem_of(key), _OWN_ONLY)
    write_new(folder / "ca.pem", authority.certificate_pem)
    return authority


def read_authority(folder: Path) -> SiteAuthority:
    """Return the site's authority.

    Raises
    ------
    SiteError
        Its files are not there, or hold something else.
    """
    try:
        key = serialization.load_pem_private_key(read_plain_bytes(folder / "ca.key"), password=None)
        certificate = x509.load_pem_x509_certificate(read_plain_bytes(folder / "ca.pem"))
    except (OSError, ValueError, TypeError) as error:
        raise SiteError(
            f"{folder} does not hold the site's authority (ca.key, ca.pem): {error}.",
            remedy="Bring ca.key back from where it is kept; without it no cell can be added to this site.",
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise SiteError(f"ca.key and ca.pem in {folder} do not belong together.", remedy="Restore both.")
    return SiteAuthority(key, certificate)


def valid_until(certificate: Path) -> datetime:
    """Return when a certificate ends."""
    try:
        return x509.load_pem_x509_certificate(read_plain_bytes(certificate)).not_valid_after_utc
    except (OSError, ValueError) as error:
        raise SiteError(f"{certificate} is no certificate: {error}.", remedy="Restore it.") from error


def write_new(path: Path, content: bytes, mode: int = 0o644) -> None:
    """Write a file where none is.

    Raises
    ------
    SiteError
        There is one.
    """
    try:
        create_file(path, content, mode=mode)
    except FileExistsError as error:
        raise SiteError(
            f"{path} is there already and is not written over.",
            remedy="Move it away first if it is to be replaced.",
            code="usage",
        ) from error


_USAGES = (
    "digital_signature",
    "content_commitment",
    "key_encipherment",
    "data_encipherment",
    "key_agreement",
    "key_cert_sign",
    "crl_sign",
    "encipher_only",
    "decipher_only",
)


def _certificate_builder(
    name: str, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.now(UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(_common_name(name))
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _EARLY)
        .not_valid_after(now + timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _alternative_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _pem_of(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
