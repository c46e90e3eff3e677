"""How a client is let in: anonymously, or over an encrypted channel to a server that is known by its certificate."""

from dataclasses import dataclass
from pathlib import Path

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.crypto.uacrypto import load_certificate
from cryptography import x509

from cellcal.calibration.message import make_message
from cellcal.drivers.errors import RefusedError


@dataclass(frozen=True, slots=True)
class CertificateFiles:
    """Our certificate with its key, and the server's own certificate, to compare with the one that answers."""

    certificate: Path
    private_key: Path
    server_certificate: Path


@dataclass(frozen=True, slots=True)
class ServerAccess:
    """The cell file's options of access; no files: a channel that is not encrypted."""

    user: str = ""
    password: str = ""
    files: CertificateFiles | None = None


async def prepare_client(device: str, client: Client, access: ServerAccess) -> None:
    """Set security and user of a client before it connects.

    Raises
    ------
    RefusedError
        A certificate or key cannot be read.
    """
    if access.user:
        client.set_user(access.user)
        client.set_password(access.password)
    if access.files is None:
        return
    try:
        client.application_uri = _application_uri(await load_certificate(access.files.certificate))
        await client.set_security(
            SecurityPolicyBasic256Sha256,
            access.files.certificate,
            access.files.private_key,
            server_certificate=access.files.server_certificate,
            mode=ua.MessageSecurityMode.SignAndEncrypt,
        )
    except (OSError, ValueError, TypeError, x509.ExtensionNotFound) as error:
        raise RefusedError(
            device,
            make_message("the certificates for the OPC UA server cannot be used: {error}.", error=error),
            remedy="Correct certificate, private_key and server_certificate in the cell file: PEM or DER files.",
        ) from error


def _application_uri(certificate: x509.Certificate) -> str:
    """Return the URI in our certificate: a server compares it with the name that the client gives itself."""
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    uris = names.get_values_for_type(x509.UniformResourceIdentifier)
    if not uris:
        raise ValueError("the client's certificate names no application URI")
    return str(uris[0])
