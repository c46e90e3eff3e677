"""Who is let in by a server that encrypts.

Imitates
    A server with the security policy Basic256Sha256, mode SignAndEncrypt, and users with passwords.
Source
    OPC 10000-4, 7.40 (user identity tokens) and OPC 10000-7 (Basic256Sha256); asyncua does the cryptography.
Modelled
    A certificate of the server's own; users by name and password, encrypted with the server's key.
Not modelled
    A list of trusted clients: every client that signs with the key of its certificate is let in.
"""

import hmac
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from asyncua import ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256, SecurityPolicyFactory
from asyncua.crypto.uacrypto import decrypt_rsa_oaep
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key


@dataclass(frozen=True)
class ServerGuard:
    """The server's certificate with its key, and its users; without users every client that encrypts is accepted."""

    POLICY: ClassVar[Any] = SecurityPolicyBasic256Sha256
    MODE: ClassVar[Any] = ua.MessageSecurityMode.SignAndEncrypt

    certificate: x509.Certificate
    private_key: Any
    users: Mapping[str, str]

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any]) -> Self | None:
        """Read certificate (DER) and key (PEM) from the files that a table names; None where it names none."""
        if "certificate" not in settings:
            return None
        certificate = x509.load_der_x509_certificate(Path(settings["certificate"]).read_bytes())
        key = load_pem_private_key(Path(settings["private_key"]).read_bytes(), None)
        return cls(certificate, key, dict(settings.get("users", {})))

    @property
    def certificate_der(self) -> bytes:
        """The server's certificate as it goes over the wire."""
        return self.certificate.public_bytes(Encoding.DER)

    def make_factory(self) -> SecurityPolicyFactory:
        """Return what makes the policy of each channel."""
        return SecurityPolicyFactory(self.POLICY, self.MODE, self.certificate, self.private_key)

    def lets_in(self, token: object, nonce: bytes) -> bool:
        """Return whether a user token is one of this server's users."""
        if not self.users:
            return not isinstance(token, ua.UserNameIdentityToken | ua.X509IdentityToken)
        if not isinstance(token, ua.UserNameIdentityToken) or token.Password is None:
            return False
        text = decrypt_rsa_oaep(self.private_key, token.Password)
        length = struct.unpack_from("<I", text)[0] - len(nonce)
        return hmac.compare_digest(
            self.users.get(token.UserName, "\0").encode(), text[4 : 4 + max(0, length)]
        )
