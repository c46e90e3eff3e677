"""Signed documents: the smallest change is found, and a key is made once."""

import json
import math
import os
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, generate_private_key
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cellcal.procedures.canonical_json import canonical_json
from cellcal.service.record.signing import (
    CellKey,
    CheckedDocument,
    CheckFinding,
    SigningError,
    check_document,
    read_document,
    read_public_key,
    station_key,
)

CONTENT = {
    "word": "pass",
    "value_m": 0.00012,
    "n": 3,
    "name": "Zäune & Öl",
    "rows": [1.0, -2.5e-07, None, True],
}


@pytest.fixture(scope="module")
def key(tmp_path_factory: pytest.TempPathFactory) -> CellKey:
    return station_key(tmp_path_factory.mktemp("cell"))


@pytest.fixture(scope="module")
def signed_document(key: CellKey) -> bytes:
    return key.sign_document("test 1", CONTENT).encode()


def test_an_untouched_document_is_intact_and_gives_its_content(key: CellKey, signed_document: bytes) -> None:
    for expected in (None, key.public_key, key.public_key.upper()):
        checked = check_document(signed_document, expected_key=expected)
        assert (checked.finding, checked.content) == (CheckFinding.INTACT, CONTENT)
    assert (checked.format, checked.public_key) == ("test 1", key.public_key)


def test_the_same_content_gives_the_same_bytes(key: CellKey, signed_document: bytes) -> None:
    assert key.sign_document("test 1", dict(reversed(CONTENT.items()))).encode() == signed_document


def test_every_byte_matters(signed_document: bytes) -> None:
    """Each byte replaced by several others, taken away, and doubled: none of them passes."""
    for place, byte in enumerate(signed_document):
        for other in {byte ^ 1, byte ^ 0x20, byte ^ 0x80, ord("0"), ord(" "), ord("\n")} - {byte}:
            assert (
                check_document(
                    signed_document[:place] + bytes([other]) + signed_document[place + 1 :]
                ).finding
                is not CheckFinding.INTACT
            )
        assert (
            check_document(signed_document[:place] + signed_document[place + 1 :]).finding
            is not CheckFinding.INTACT
        )
        assert (
            check_document(signed_document[: place + 1] + signed_document[place:]).finding
            is not CheckFinding.INTACT
        )


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_other_change_passes(signed_document: bytes, data: st.DataObject) -> None:
    place = data.draw(st.integers(0, len(signed_document)))
    until = data.draw(st.integers(place, min(len(signed_document), place + 20)))
    changed = signed_document[:place] + data.draw(st.binary(max_size=20)) + signed_document[until:]
    assert (check_document(changed).finding is CheckFinding.INTACT) == (changed == signed_document)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace('"n":3', '"n":3.0'),
        lambda text: text.replace('"n":3', '"n": 3'),
        lambda text: text.replace("-2.5e-07", "-0.00000025"),
        lambda text: text.replace('"n":3', '"n":4,"n":3'),
        lambda text: text.replace("ö", "\\u00f6").replace("Ö", "\\u00d6"),
        lambda text: json.dumps(json.loads(text)),
        lambda text: text + "\n",
        lambda text: text.replace("ed25519", "ED25519"),
        lambda text: text.replace("0.00012", "1e999"),
        lambda text: text.replace("0.00012", "NaN"),
        lambda text: text.replace('"pass"', '"\\ud800"'),
    ],
)
def test_the_same_meaning_in_other_bytes_is_tampered_too(signed_document: bytes, change) -> None:
    changed = change(signed_document.decode())
    assert changed.encode(errors="surrogatepass") != signed_document
    assert check_document(changed.encode(errors="surrogatepass")).finding is CheckFinding.TAMPERED


@pytest.mark.parametrize(
    "raw",
    [
        b"",
        b"\xff\xfe",
        b"{}",
        b"[]",
        b"null",
        b"{" * 100_000,
        b'{"content":1}',
        b'{"content":' + b"9" * 9999 + b"}",
    ],
)
def test_what_was_never_signed_is_unreadable(raw: bytes) -> None:
    assert check_document(raw).finding is CheckFinding.UNREADABLE


def test_another_key_is_an_unknown_key(key: CellKey, tmp_path: Path) -> None:
    forged = station_key(tmp_path).sign_document("test 1", CONTENT).encode()
    assert (
        check_document(forged).finding is CheckFinding.INTACT
    )  # it states that the key's owner was not checked
    found = check_document(forged, expected_key=key.public_key)
    assert (found.finding, found.content) == (CheckFinding.UNKNOWN_KEY, None)


def test_a_signature_does_not_travel_to_another_format(key: CellKey, signed_document: bytes) -> None:
    document = json.loads(signed_document)
    document["format"] = "test 2"
    assert check_document((canonical_json(document) + "\n").encode()).finding is CheckFinding.TAMPERED


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_no_number_that_is_not_finite_is_signed(key: CellKey, wrong: float) -> None:
    with pytest.raises(SigningError, match="cannot be signed"):
        key.sign_document("test 1", {"value": [wrong]})


def test_a_key_is_made_once_for_its_owner_only(tmp_path: Path) -> None:
    first = station_key(tmp_path / "data")
    assert first.created
    assert stat.S_IMODE(first.path.stat().st_mode) == 0o600
    assert not first.open_to_others
    key_bytes = first.path.read_bytes()
    again = station_key(tmp_path / "data")
    assert (again.created, again.public_key, first.path.read_bytes()) == (False, first.public_key, key_bytes)
    assert os.listdir(tmp_path / "data") == [first.path.name]  # noqa: PTH208
    first.path.chmod(0o644)
    assert station_key(tmp_path / "data").open_to_others


def test_two_at_once_end_with_one_key(tmp_path: Path) -> None:
    with ThreadPoolExecutor(8) as pool:
        keys = list(pool.map(lambda _: station_key(tmp_path), range(8)))
    assert len({key.public_key for key in keys}) == 1
    assert sum(key.created for key in keys) == 1


def test_a_damaged_key_is_left_alone_and_reported(tmp_path: Path) -> None:
    other = generate_private_key(SECP256R1()).private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    for content in (b"", b"nonsense", b"\xff", other):
        path = tmp_path / "signing_key.pem"
        path.write_bytes(content)
        with pytest.raises(SigningError, match="holds no signing key") as error_info:
            station_key(tmp_path)
        assert "backup" in error_info.value.remedy
        assert path.read_bytes() == content


def test_a_key_in_a_place_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("in the way")
    with pytest.raises(SigningError, match="cannot be used"):
        station_key(tmp_path / "data")


def test_a_public_key_is_given_as_digits_or_as_a_file(key: CellKey, tmp_path: Path) -> None:
    digits, pem = tmp_path / "key.txt", tmp_path / "key.pem"
    digits.write_text(key.public_key + "\n")
    pem.write_bytes(
        key.private.public_key().public_bytes(
            serialization.Encoding.PEM, serialization.PublicFormat.SubjectPublicKeyInfo
        )
    )
    for key_text in (key.public_key, key.public_key.upper(), str(digits), str(pem)):
        assert read_public_key(key_text) == key.public_key
    digits.write_text("-----BEGIN PUBLIC KEY-----\nxx\n-----END PUBLIC KEY-----")
    for wrong in ("", "abc", str(digits), str(tmp_path), "x" * 5000, "a\0b", str(tmp_path / "none")):
        with pytest.raises(SigningError, match="no public key"):
            read_public_key(wrong)


def test_a_file_that_cannot_be_read_is_reported(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "none", Path("a\0b")):
        found = read_document(path)
        assert isinstance(found, CheckedDocument)
        assert found.finding is CheckFinding.UNREADABLE
