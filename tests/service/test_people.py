"""The register of people: what is kept, how often may be guessed, and the commands that keep it."""

import contextlib
import hashlib
import io
import re
import sqlite3
import threading
import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec

from cellcal.calibration.errors import CellError
from cellcal.service.cli.app import run_command_line
from cellcal.service.cli.serve_checks import ListenAddress, refuse_unguarded
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.people.accounts import REGISTER_NAME, AccountStore
from cellcal.service.people.authentication import Authenticator
from cellcal.service.people.errors import PeopleError, TooManyGuessesError, WrongSecretError
from cellcal.service.people.naming import clean_name, refuse_weak
from cellcal.service.people.pin_hashing import PEPPER_NAME, PinHasher, pepper_of
from cellcal.service.people.rate_limits import DAY_S
from cellcal.service.people.roles import KEEPS, MOVES, WRITES, Role
from tests.service.service_client import PINS, ServiceClock, cheap_hasher, with_people

PROCEDURES = Path(__file__).parents[2] / "procedures"


# what a yes brings


def test_every_question_that_accepts_approves_or_moves_is_in_one_table() -> None:
    """The tables of roles are written by hand; the procedures say what there is."""
    texts = [path.read_text(encoding="utf-8") for path in PROCEDURES.rglob("*.py")]
    keys = {
        key for text in texts for key in re.findall(r'"((?:accept|approve|may|write|sign)_[a-z_]+)",', text)
    }
    assert len(keys) > 8
    assert keys == WRITES | KEEPS | MOVES
    assert len(WRITES) + len(KEEPS) + len(MOVES) == len(keys)


def test_every_question_before_a_write_is_among_those_that_write() -> None:
    """In a procedure that writes master data, what it asks is a plan, parameters to keep, or a yes to writing."""
    work = "write_mastering|write_user_frame|write_and_read_back"
    writing = re.compile(rf"run\.write\(\s*\"[^\"]+\",\s*(?:{work})")
    elsewhere = {  # questions in another file than the write
        "correction_instruction": "accept_mastering",
        "tool_instruction": "accept_tool",
        "ask_to_write_user_frame": "accept_frame",
        "zeros_instruction": "accept_zeros",
    }
    question_keys = set()
    for path in PROCEDURES.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        if not writing.search(text):
            continue
        keys_in_text = set(re.findall(r'"(accept_[a-z_]+)",', text))
        keys_in_text |= {key for name, key in elsewhere.items() if f"{name}(" in text}
        assert keys_in_text & WRITES, path.name
        assert keys_in_text <= WRITES | {"accept_plan", "accept_parameters"}, path.name
        question_keys |= keys_in_text & WRITES
    assert question_keys == WRITES


# PINs at rest


def test_a_pin_is_kept_as_argon2id_with_a_pepper_that_is_elsewhere(tmp_path: Path) -> None:
    hasher = PinHasher(pepper_of(tmp_path))
    stored_hash = hasher.hash_secret("314159")
    assert stored_hash.startswith("$argon2id$v=19$m=65536,t=3,p=4$")
    assert hasher.is_right(stored_hash, "314159")
    assert not hasher.is_right(stored_hash, "314158")
    assert not PinHasher(bytes(32)).is_right(stored_hash, "314159")
    assert (tmp_path / PEPPER_NAME).stat().st_mode & 0o777 == 0o600
    assert pepper_of(tmp_path) == hasher.pepper
    assert not hasher.is_right("no hash", "314159")


def test_no_secret_stands_in_the_register_in_clear(tmp_path: Path) -> None:
    authenticator = with_people(Authenticator(tmp_path))
    token = authenticator.accounts.create_enrolment("tablet", "test")
    raw = (tmp_path / REGISTER_NAME).read_bytes()
    pepper = (tmp_path / PEPPER_NAME).read_bytes()
    assert all(pin.encode() not in raw for pin in PINS.values())
    assert token.encode() not in raw
    assert pepper not in raw
    assert (tmp_path / REGISTER_NAME).stat().st_mode & 0o077 == 0


def test_the_pepper_may_come_from_the_service_manager(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pepper = hashlib.sha256(b"x").digest()
    (tmp_path / "cellcal-pepper").write_bytes(pepper)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))
    data = tmp_path / "data"
    assert pepper_of(data) == pepper
    assert not data.exists()


@pytest.mark.parametrize("fault", ["open to others", "cut", "another"])
def test_a_pepper_that_is_not_right_is_reported(tmp_path: Path, fault: str) -> None:
    authenticator = with_people(Authenticator(tmp_path, make_hasher=cheap_hasher))
    path = tmp_path / PEPPER_NAME
    if fault == "open to others":
        path.chmod(0o644)
    else:
        path.write_bytes(bytes(16 if fault == "cut" else 32))
    session = authenticator.from_console(authenticator.console_token())
    with pytest.raises(PeopleError, match="pepper") as error_info:
        authenticator.sign_in(session, "Tom", PINS["Tom"])
    assert not isinstance(error_info.value, WrongSecretError)


@pytest.mark.parametrize(
    ("secret", "role"),
    [
        ("12345", Role.TECHNICIAN),
        ("123456", Role.TECHNICIAN),
        ("987654", Role.VIEWER),
        ("111111", Role.TECHNICIAN),
        ("121212", Role.TECHNICIAN),
        ("314159", Role.ENGINEER),
        ("short words", Role.ADMIN),
        ("", Role.VIEWER),
        ("x" * 5000, Role.ENGINEER),
    ],
)
def test_a_weak_secret_is_refused(secret: str, role: Role) -> None:
    with pytest.raises(PeopleError):
        refuse_weak(secret, role)


@pytest.mark.parametrize(
    "name", ["", "  ", "a\nb", "a\u202eb", "a\x00b", "x" * 61, "service", "Local Technician"]
)
def test_a_name_that_cannot_be_read_or_is_the_service_s_own_is_refused(name: str) -> None:
    with pytest.raises(PeopleError):
        clean_name(name)


# guesses


def test_one_person_s_pin_is_guessed_at_most_thirty_times_a_day_from_all_devices(tmp_path: Path) -> None:
    clock = ServiceClock()
    register = AccountStore(tmp_path, clock)
    tried = _count_tries(
        register, clock, every_s=300.0, name=lambda _: "Tom", device=lambda n: f"device {n % 50}"
    )
    assert 20 <= tried <= 30


def test_a_success_does_not_give_more_than_the_day_s_share(tmp_path: Path) -> None:
    clock = ServiceClock()
    register = AccountStore(tmp_path, clock)
    failed = 0
    for n in range(400):
        clock.pass_by(60.0)
        try:
            guess = register.note_guess("Tom", f"device {n}")
        except TooManyGuessesError:
            continue
        if n % 5 == 4:
            register.guessed_right(guess, "Tom")
        else:
            failed += 1
    assert failed == 30


def test_one_device_and_the_whole_station_have_their_share(tmp_path: Path) -> None:
    clock = ServiceClock()
    device = AccountStore(tmp_path / "device", clock)
    assert (
        20
        < _count_tries(device, clock, every_s=600.0, name=lambda n: f"p{n}", device=lambda _: "tablet")
        <= 60
    )
    station = AccountStore(tmp_path / "station", clock)
    named = {"name": lambda n: f"p{n}", "device": lambda n: f"d{n}"}
    assert _count_tries(station, clock, every_s=600.0, **named) == 100
    clock.pass_by(DAY_S)
    station.note_guess("a name", "an address")


def _count_tries(
    register: AccountStore, clock: ServiceClock, *, every_s: float, name: object, device: object
) -> int:
    tried = 0
    for n in range(int(DAY_S / every_s) - 1):
        clock.pass_by(every_s)
        try:
            register.note_guess(name(n), device(n))  # type: ignore[operator]
        except TooManyGuessesError:
            continue
        tried += 1
    return tried


def test_many_guesses_at_once_are_no_more(tmp_path: Path) -> None:
    register = AccountStore(tmp_path, ServiceClock())
    let_through: list[int] = []

    def guess_pin() -> None:
        with contextlib.suppress(TooManyGuessesError):
            let_through.append(register.note_guess("Tom", "tablet"))

    threads = [threading.Thread(target=guess_pin) for _ in range(16)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(let_through) == 5


def test_a_clock_that_is_set_back_causes_no_lockout_for_years(tmp_path: Path) -> None:
    clock = ServiceClock()
    register = AccountStore(tmp_path, clock)
    clock.pass_by(20 * 365 * DAY_S)
    for _ in range(5):
        register.note_guess("Tom", "tablet")
    clock.pass_by(-20 * 365 * DAY_S)
    register.note_guess("Tina", "tablet")
    clock.pass_by(3601.0)
    register.note_guess("Tom", "tablet")


def test_the_computers_clock_shortens_and_lengthens_no_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    register, now_s = AccountStore(tmp_path), time.time()
    for _ in range(5):
        register.note_guess("Tom", "tablet")
    for moved_s in (3700.0, 2 * DAY_S, -2 * DAY_S, 0.0):
        monkeypatch.setattr(time, "time", lambda moved_s=moved_s: now_s + moved_s)
        with pytest.raises(TooManyGuessesError, match="60 min"):
            register.note_guess("Tom", "tablet")


def test_an_invitation_ends_also_where_the_clock_is_set_back(tmp_path: Path) -> None:
    now_s = 1e9
    register = AccountStore(tmp_path, lambda: now_s)
    tokens = [register.create_enrolment("tablet", "test") for _ in range(2)]
    now_s -= 0.5  # as a time server corrects it
    register.enrol_device(tokens[0], b"key")
    now_s -= 86400.0
    with pytest.raises(WrongSecretError):
        register.enrol_device(tokens[1], b"key")


def test_guesses_are_counted_over_a_restart_and_taken_back_by_a_reset(tmp_path: Path) -> None:
    clock = ServiceClock()
    with_people(Authenticator(tmp_path, wall_clock=clock))
    for _ in range(5):
        AccountStore(tmp_path, clock).note_guess("Tom", "tablet")
    with pytest.raises(TooManyGuessesError, match="60 min"):
        AccountStore(tmp_path, clock).note_guess("TOM ", "tablet")
    AccountStore(tmp_path, clock).reset_person("Tom", Role.TECHNICIAN, "kept", "test")
    AccountStore(tmp_path, clock).note_guess("Tom", "tablet")


# the register


def test_a_name_is_given_once(tmp_path: Path) -> None:
    register = AccountStore(tmp_path)
    register.add_person("Anna Bauer", Role.VIEWER, "kept", "test")
    register.remove_person("anna  bauer", "test")
    for name in ("Anna Bauer", "ANNA BAUER", "\uff21nna Bauer"):
        with pytest.raises(PeopleError, match="already"):
            register.add_person(name, Role.VIEWER, "kept", "test")
    assert [what for _, _, what in register.list_events()] == ["add viewer Anna Bauer", "remove Anna Bauer"]


@pytest.mark.parametrize("fault", ["no database", "newer"])
def test_an_unreadable_register_allows_no_sign_in(tmp_path: Path, fault: str) -> None:
    authenticator = Authenticator(tmp_path)
    session = authenticator.from_console(authenticator.console_token())
    if fault == "newer":
        with sqlite3.connect(tmp_path / REGISTER_NAME) as database:
            database.execute("PRAGMA user_version = 99")
        database.close()
    else:
        (tmp_path / REGISTER_NAME).write_bytes(b"not a database, whatever its name says" * 100)
    with pytest.raises(PeopleError):
        authenticator.authenticate(session)


# commands


@pytest.fixture
def cell_file(tmp_path: Path) -> Path:
    return write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)


@pytest.fixture
def run_cellcal(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    def run_command(*arguments: str, typed: str = "") -> int:
        monkeypatch.setattr("sys.stdin", io.StringIO(typed))
        return run_command_line(arguments)

    return run_command


def test_people_are_added_listed_and_removed_by_command(
    cell_file: Path, run_cellcal: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    add = ("people", "add", "Anna", "--cell", str(cell_file), "--role", "technician", "--secret-stdin")
    assert run_cellcal(*add, typed="123456\n") != 0
    assert run_cellcal(*add, typed="314159\n") == 0
    run_cellcal("people", "list", "--cell", str(cell_file), "--json")
    listed = capsys.readouterr()
    assert '"people": [{"name": "Anna", "role": "technician"}]' in listed.out
    authenticator = Authenticator(read_cell_file(cell_file).cell.data_dir)
    session = authenticator.sign_in(
        authenticator.from_console(authenticator.console_token()), "Anna", "314159"
    )
    assert authenticator.authenticate(session).role is Role.TECHNICIAN
    assert run_cellcal("people", "remove", "Anna", "--cell", str(cell_file)) == 0
    assert authenticator.authenticate(session).role is Role.VIEWER
    assert "314159" not in listed.out + listed.err


def test_a_device_is_invited_with_an_address_for_https_or_this_computer_only(
    cell_file: Path, run_cellcal: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    invite = ("people", "enrol-device", "tablet 3", "--cell", str(cell_file), "--url")
    assert run_cellcal(*invite, "http://cell7.plant:8470") == 2
    assert run_cellcal(*invite, "https://cell7.plant:8470") == 0
    assert re.fullmatch(r"https://cell7\.plant:8470/#/enrol/[\w-]{43}\n", capsys.readouterr().out)


def certificate_for(folder: Path, name: str) -> tuple[Path, Path]:
    key = ec.generate_private_key(ec.SECP256R1())
    named = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    made = (
        x509.CertificateBuilder()
        .subject_name(named).issuer_name(named).public_key(key.public_key()).serial_number(1)
        .not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=1))
        .sign(key, hashes.SHA256())
    )  # fmt: skip
    certificate, private = folder / f"{name}.pem", folder / f"{name}.key"
    certificate.write_bytes(made.public_bytes(serialization.Encoding.PEM))
    private.write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        )
    )
    private.chmod(0o600)
    return certificate, private


def test_beyond_this_computer_all_of_tls_an_administrator_and_names_are_wanted(
    cell_file: Path, tmp_path: Path
) -> None:
    certificate, key = certificate_for(tmp_path, "cell7")
    data_dir = read_cell_file(cell_file).cell.data_dir
    for each_options in (
        ListenAddress("0.0.0.0"),
        ListenAddress("0.0.0.0", certificate, key, ("cell7.plant",)),
        ListenAddress("::", certificate, key),
        ListenAddress("cell7.plant", hosts=("cell7.plant",)),
    ):
        with pytest.raises(CellError, match="not this computer alone"):
            refuse_unguarded(cell_file, each_options)
    with_people(Authenticator(data_dir))
    refuse_unguarded(cell_file, ListenAddress("0.0.0.0", certificate, key, ("cell7.plant",)))
    with pytest.raises(CellError, match="allow-host"):
        refuse_unguarded(cell_file, ListenAddress("0.0.0.0", certificate, key))
    with pytest.raises(CellError, match="TLS"):
        refuse_unguarded(cell_file, ListenAddress("0.0.0.0", hosts=("cell7.plant",)))
    AccountStore(data_dir).remove_person("Ada", "test")
    with pytest.raises(CellError, match="administrator"):
        refuse_unguarded(cell_file, ListenAddress("0.0.0.0", certificate, key, ("cell7.plant",)))


def test_an_unusable_certificate_is_reported_before_serving(cell_file: Path, tmp_path: Path) -> None:
    certificate, key = certificate_for(tmp_path, "cell7")
    _, other = certificate_for(tmp_path, "other")
    for pair in ((certificate, other), (tmp_path / "none.pem", key), (certificate, None)):
        with pytest.raises(CellError):
            refuse_unguarded(cell_file, ListenAddress("127.0.0.1", *pair))
    for name in ("*", "https://cell7", "cell7:8470", ""):
        with pytest.raises(CellError, match="host"):
            refuse_unguarded(cell_file, ListenAddress("127.0.0.1", hosts=(name,)))
    key.chmod(0o644)
    with pytest.raises(CellError, match="other users"):
        refuse_unguarded(cell_file, ListenAddress("127.0.0.1", certificate, key))


def test_serve_refuses_the_network_without_its_guards(
    cell_file: Path, run_cellcal: Callable[..., int], capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_cellcal("serve", str(cell_file), "--host", "0.0.0.0", "--port", "1") == 2
    message = capsys.readouterr().err.replace("\n", " ")
    for missing in ("TLS certificate", "administrator", "--allow-host"):
        assert missing in message
