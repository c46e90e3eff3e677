"""OPC UA servers that encrypt and know their users, and the life of a channel."""

from pathlib import Path

import pytest
from asyncua.crypto import cert_gen
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding

from cellcal.drivers.errors import RefusedError
from tests.machine_speed import stretched_s
from tests.wire.opc_ua_server import (
    believed,
    config_of,
    failure_of,
    failure_of_opening,
    fake_server,
    reads_again,
)

pytestmark = pytest.mark.timeout(stretched_s(60.0))


def write_pair(folder: Path, name: str) -> dict[str, str]:
    """Write a certificate of its own and the key to it; return both paths."""
    key = cert_gen.generate_private_key()
    certificate = cert_gen.generate_self_signed_app_certificate(
        key, name, {}, [x509.UniformResourceIdentifier(f"urn:test:{name}")], extended=[]
    )
    paths = {"certificate": str(folder / f"{name}.der"), "private_key": str(folder / f"{name}.pem")}
    Path(paths["certificate"]).write_bytes(certificate.public_bytes(Encoding.DER))
    Path(paths["private_key"]).write_bytes(cert_gen.dump_private_key_as_pem(key))
    return paths


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """Certificates of a server, of another server, and of us."""
    folder = tmp_path_factory.mktemp("certificates")
    return {name: write_pair(folder, name) for name in ("server", "other", "ours")}


async def test_a_server_that_encrypts_is_read_with_certificates_and_password(
    pairs: dict[str, dict[str, str]],
) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["server"]["certificate"]}
    async with fake_server({**pairs["server"], "users": {"reader": "s3cret"}}) as fake:
        config = config_of(fake, **ours, user="reader", password="s3cret")
        async with config.open() as robot:
            assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
            await fake.inject_fault("restart", {"shuffled": True})
            await failure_of(robot.read_joints())
            await reads_again(robot, fake)
        for changes in ({"password": "guess"}, {"user": "other"}, {"user": "", "password": ""}):
            failure = await failure_of_opening(config.model_copy(update=changes))
            assert isinstance(failure, RefusedError)
            assert "certificates" in failure.remedy
        assert isinstance(await failure_of_opening(config_of(fake)), RefusedError)  # without encryption


@pytest.mark.parametrize("encrypts", [True, False])
async def test_a_channel_is_renewed_before_its_life_ends(
    pairs: dict[str, dict[str, str]], encrypts: bool
) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["server"]["certificate"]}
    settings, changes = (pairs["server"], ours) if encrypts else ({}, {})
    async with fake_server(settings) as fake, config_of(fake, **changes).open() as robot:
        session = robot._link.session_number
        for _ in range(3):
            robot._link._renew_at_s = 0.0
            assert (await robot.read_joints()).joints_rad == pytest.approx(believed(fake), abs=1e-9)
            assert robot._link._renew_at_s > 0.0
        assert robot._link.session_number == session


async def test_a_server_with_another_certificate_is_not_talked_to(pairs: dict[str, dict[str, str]]) -> None:
    ours = {**pairs["ours"], "server_certificate": pairs["other"]["certificate"]}
    async with fake_server(pairs["server"]) as fake:
        assert "server_certificate" in (await failure_of_opening(config_of(fake, **ours))).remedy
    async with fake_server() as fake:  # one that does not encrypt at all
        await failure_of_opening(config_of(fake, **ours))


async def test_certificates_that_cannot_be_read_are_named(
    pairs: dict[str, dict[str, str]], tmp_path: Path
) -> None:
    broken = tmp_path / "broken.der"
    broken.write_bytes(b"no certificate")
    async with fake_server(pairs["server"]) as fake:
        for wrong in (str(broken), str(tmp_path / "missing.der")):
            files = {
                **pairs["ours"],
                "server_certificate": pairs["server"]["certificate"],
                "certificate": wrong,
            }
            failure = await failure_of_opening(config_of(fake, **files))
            assert isinstance(failure, RefusedError)
            assert "certificate" in failure.remedy
