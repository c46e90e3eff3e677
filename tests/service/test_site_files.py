"""What the bus rests on, without the bus: enrolment, rules, signatures, outbox, store, alarms."""

import json
import sqlite3
import stat
from contextlib import closing
from pathlib import Path

import pytest
import zenoh
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from hypothesis import given
from hypothesis import strategies as st

from cellcal.calibration.errors import CellError
from cellcal.service.cli.app import run_command_line
from cellcal.service.configuration.cell_file import read_cell_file
from cellcal.service.demo.fake_cell import write_cell_file
from cellcal.service.exit_codes import ExitCode
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import certificates_folder
from cellcal.service.record.robot_lock import acquire_lease
from cellcal.service.record.signing import CellKey, station_key
from cellcal.service.site.access import ASKING, CELL_MESSAGES, cell_access, router_access
from cellcal.service.site.alarms import STEADY_S, AlarmSet, CellAlarm, list_alarms
from cellcal.service.site.answers import CellAnswers
from cellcal.service.site.enrolment import CellApplicant, NewSite, enroll_cells, parse_applicant
from cellcal.service.site.fleet import SILENT_S, Fleet
from cellcal.service.site.journal_tail import JournalTail, chain_flaw, event_to_json
from cellcal.service.site.keys import key_part
from cellcal.service.site.ledger import SiteLedger
from cellcal.service.site.link_files import CELL_FILE, EnrolledCell, StationsFile, read_link_folder
from cellcal.service.site.outbox import SiteOutbox, UnsentEvent, rows_between
from cellcal.service.site.publisher import CERTIFICATES, site_folder
from cellcal.service.site.signed_messages import MessageSigner, SignedMessage, open_message, public_key
from cellcal.service.site.site_store import ReceivedEvent, SiteStore
from tests.service.loopback_site import live_of, session_of

NEW = NewSite("hall-3", "127.0.0.1:7447")
KEYS = [f"{k:064x}" for k in range(1, 9)]


def files_in(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


# enrolment


def test_keys_are_for_their_owner_and_a_second_enrolment_only_adds(tmp_path: Path) -> None:
    site = tmp_path / "site"
    enroll_cells(site, [CellApplicant("cell-07", KEYS[0])], NEW)
    before = files_in(site)
    assert {path.name for path in before if path.suffix == ".key"} == {
        "ca.key", "site-router.key", "site-monitor.key", "cell-07.key",
    }  # fmt: skip
    for path in before:
        if path.suffix == ".key":
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
    enroll_cells(site, [CellApplicant("cell-08", KEYS[1])])
    after = files_in(site)
    changed = {path.name for path in before if after[path] != before[path]}
    assert changed == {"router.json5", "stations.json"}
    rules = json.loads((site / "router" / "router.json5").read_text())["access_control"]
    assert {subject["id"] for subject in rules["subjects"]} == {"monitor", "cell-cell-07", "cell-cell-08"}


@pytest.mark.parametrize(
    ("cells", "words"),
    [
        ([CellApplicant("cell-07", KEYS[2])], "enrolled already"),
        ([CellApplicant("cell-08", KEYS[0])], "would be one cell"),
        ([CellApplicant("cell-09", KEYS[3]), CellApplicant("cell-09", KEYS[4])], "two cells"),
    ],
)
def test_what_would_be_written_over_is_refused_and_nothing_changes(tmp_path: Path, cells, words: str) -> None:
    site = tmp_path / "site"
    enroll_cells(site, [CellApplicant("cell-07", KEYS[0])], NEW)
    before = files_in(site)
    with pytest.raises(CellError, match=words):
        enroll_cells(site, cells)
    assert files_in(site) == before


def test_a_site_is_begun_once_and_needs_a_name(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="no site yet"):
        enroll_cells(tmp_path / "site", [CellApplicant("cell-07", KEYS[0])])
    enroll_cells(tmp_path / "site", [], NEW)
    with pytest.raises(CellError, match="holds a site already"):
        enroll_cells(tmp_path / "site", [], NEW)


@pytest.mark.parametrize(
    "word", ["site-monitor", "site-router", "Cell", "a/b", "*", "", "-a", "a" * 33, "..", "@a"]
)
def test_no_cell_gets_a_name_that_means_more_than_one_cell(word: str) -> None:
    with pytest.raises(CellError):
        parse_applicant(f"{word}={KEYS[0]}")


def test_a_cell_without_its_public_key_is_not_enrolled(tmp_path: Path) -> None:
    with pytest.raises(CellError, match="is no cell file"):
        parse_applicant("cell-07")
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    found = parse_applicant(str(path))
    assert found == CellApplicant("demo", station_key(tmp_path / "data").public_key)


def test_the_command_enrols_a_cell_of_this_computer(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    enrol = ["site", "enroll", str(path), "--folder", str(tmp_path / "site")]
    assert run_command_line(enrol) == ExitCode.USAGE  # no site yet
    assert run_command_line([*enrol, "--name", "hall-3", "--endpoint", "no endpoint"]) == ExitCode.USAGE
    assert not (tmp_path / "site").exists()
    assert run_command_line([*enrol, "--name", "hall-3", "--endpoint", "127.0.0.1:7447"]) == 0
    path.write_text(path.read_text() + '\n[site]\nfolder = "site/cells/demo"\n')
    assert read_link_folder(site_folder(read_cell_file(path)), CELL_FILE).own_certificate.name == "demo.pem"
    assert run_command_line(enrol) == ExitCode.USAGE  # a second time


def test_a_key_that_others_may_read_is_not_used(tmp_path: Path) -> None:
    (folder,) = enroll_cells(tmp_path / "site", [CellApplicant("cell-07", KEYS[0])], NEW)
    assert read_link_folder(folder, CELL_FILE).own_certificate == folder / "cell-07.pem"
    (folder / "cell-07.key").chmod(0o640)
    with pytest.raises(CellError, match="may read the private key"):
        read_link_folder(folder, CELL_FILE)


def test_the_rules_deny_by_default_and_no_subject_is_a_wildcard() -> None:
    cells = ["cell-07", "cell-08"]
    for access in (router_access("hall-3", cells), cell_access("hall-3", "cell-07")):
        assert access["default_permission"] == "deny"
        assert access["enabled"] is True
        for subject in access["subjects"]:
            assert all(name.strip() for name in subject["cert_common_names"])
            assert len(subject["cert_common_names"]) == 1
        assert all(rule["permission"] == "allow" for rule in access["rules"])
    for rule in cell_access("hall-3", "cell-07")["rules"]:
        assert rule["flows"] == ["ingress"] if rule["messages"] == ASKING else ["egress"]
    router = {rule["id"]: rule for rule in router_access("hall-3", cells)["rules"]}
    puts_in = [rule for rule in router.values() if "put" in rule["messages"] and "ingress" in rule["flows"]]
    assert [rule["key_exprs"][0] for rule in puts_in] == [f"cellcal/v1/hall-3/{cell}/**" for cell in cells]
    assert set(ASKING).isdisjoint(CELL_MESSAGES)


def test_zenohs_own_router_reads_the_file_and_holds_joints_to_a_rate(tmp_path: Path) -> None:
    """`zenohd -c` reads a file as `from_file` does, and stops at a word that it does not know."""
    site = tmp_path / "site"
    keys = {cell: station_key(tmp_path / cell).public_key for cell in ("cell-07", "cell-08")}
    enroll_cells(
        site, [CellApplicant(cell, key) for cell, key in keys.items()], NewSite("hall-3", "127.0.0.1:7447")
    )
    (rate,) = json.loads(zenoh.Config.from_file(site / "router" / "router.json5").get_json("downsampling"))
    assert (rate["flows"], rate["messages"]) == (["ingress"], ["put"])
    assert [rule["key_expr"] for rule in rate["rules"]] == ["cellcal/v1/hall-3/*/joints"]


def test_the_site_table_is_off_unless_it_is_written(tmp_path: Path) -> None:
    path = write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0)
    assert read_cell_file(path).site is None
    path.write_text(path.read_text() + '\n[site]\nfolder = "bus"\n')
    site = read_cell_file(path).site
    assert site is not None
    assert site.folder == tmp_path / "bus"
    path.write_text(path.read_text() + "listen = true\n")
    with pytest.raises(CellError, match=r"site\.listen: unknown key"):
        read_cell_file(path)


@given(st.text(min_size=1, max_size=80), st.text(min_size=1, max_size=80))
def test_names_become_parts_of_keys_and_stay_different(left: str, right: str) -> None:
    parts = key_part(left), key_part(right)
    for part in parts:
        assert 0 < len(part) <= 32
        assert set(part) <= set("abcdefghijklmnopqrstuvwxyz0123456789-")
    assert (parts[0] == parts[1]) == (left == right)


# signatures

_KEY = CellKey(Path("none"), Ed25519PrivateKey.generate(), created=True)


@given(st.integers(min_value=0), st.integers(min_value=0, max_value=255))
def test_no_byte_of_a_message_can_be_changed(place: int, value: int) -> None:
    body = {"a": [1.5, "ü", None], "b": {"c": 1e-9}}
    raw = MessageSigner(_KEY, "cell-07", "e").sign_message("k", 1, body, "2026-01-01T00:00:00+00:00")
    public = public_key(_KEY.public_key)
    assert isinstance(open_message(raw, "k", "cell-07", public), SignedMessage)
    changed = bytearray(raw)
    changed[place % len(raw)] = value
    found = open_message(bytes(changed), "k", "cell-07", public)
    if isinstance(found, SignedMessage):
        assert json.loads(bytes(changed)) == json.loads(raw)  # says the same, for example in other blanks


def test_numbers_that_are_not_finite_are_neither_signed_nor_believed(tmp_path: Path) -> None:
    sealer = MessageSigner(station_key(tmp_path), "cell-07", "e")
    with pytest.raises(ValueError, match="JSON"):
        sealer.sign_message("k", 1, {"a": float("nan")})
    raw = sealer.sign_message("k", 1, {"a": 1.0}).replace(b"1.0", b"1e999")
    assert not isinstance(open_message(raw, "k", "cell-07", public_key(sealer.key.public_key)), SignedMessage)


# outbox and store


def add_events(outbox: SiteOutbox, count: int, first: int = 1) -> None:
    outbox.add_events([UnsentEvent("k", lambda seq: b"%d" % seq, first + k) for k in range(count)])


def test_the_outbox_numbers_without_holes_and_each_event_once(tmp_path: Path) -> None:
    with SiteOutbox(tmp_path) as outbox:
        add_events(outbox, 5)
        add_events(outbox, 5, first=3)
        assert [row.seq for row in rows_between(outbox.path, 1, 100)] == list(range(1, 8))
        lives = [outbox.next_live(), outbox.next_live()]
        with pytest.raises(CellError, match="already tells"):
            SiteOutbox(tmp_path)
        epoch = outbox.epoch
    with SiteOutbox(tmp_path, kept_rows=3) as again:
        assert again.epoch == epoch
        assert again.next_live() > lives[1] > lives[0]
        add_events(again, 1, first=8)
        assert again.number_bounds() == (6, 8)
        assert again.last_journal_seq() == 8
    (tmp_path / "site_outbox.sqlite").unlink()
    with SiteOutbox(tmp_path) as new:
        assert new.epoch > epoch


def test_a_failure_while_signing_leaves_no_hole(tmp_path: Path) -> None:
    def fail_signing(seq: int) -> bytes:
        raise ValueError(seq)

    with SiteOutbox(tmp_path) as outbox:
        with pytest.raises(ValueError, match="2"):
            outbox.add_events([UnsentEvent("k", lambda seq: b"x"), UnsentEvent("k", fail_signing)])
        assert outbox.number_bounds() == (1, 0)
        add_events(outbox, 1)
        assert outbox.number_bounds() == (1, 1)


def received_event(seq: int, body: object = None, raw: bytes = b"", epoch: str = "e1") -> ReceivedEvent:
    return ReceivedEvent(SignedMessage("cell-07", epoch, seq, "now", "k", body), raw or b"%d" % seq)


@given(st.permutations(list(range(1, 13))), st.lists(st.integers(1, 12), max_size=8))
def test_events_in_any_order_and_doubled_are_kept_once(order: list[int], doubled: list[int]) -> None:
    with SiteStore(Path(":memory:")) as store:
        for seq in order + doubled:
            assert store.add_events([received_event(seq)]) == []
            have = set(store.event_numbers("cell-07"))
            reach = store.event_reach("cell-07", "e1").upto
            assert set(range(1, reach + 1)) <= have
            assert reach + 1 not in have
        assert store.event_numbers("cell-07") == list(range(1, 13))


def test_what_a_cell_no_longer_has_is_counted_as_lost(tmp_path: Path) -> None:
    with SiteStore(tmp_path / "s.sqlite") as store:
        store.add_events([received_event(1), received_event(2), received_event(5)])
        assert store.update_reach("cell-07", "e1", 1, 9).missing_count == 7
        reach = store.update_reach("cell-07", "e1", 8, 9)
        assert (reach.upto, reach.existing, reach.lost) == (7, 9, 4)  # 3, 4, 6, 7
    with SiteStore(tmp_path / "s.sqlite") as store:
        store.add_events([received_event(8), received_event(9)])
        assert store.update_reach("cell-07", "e1", 8, 9).missing_count == 0
        assert store.event_reach("cell-07", "e1").lost == 4


def test_two_events_under_one_number_and_a_rewritten_journal_are_named(tmp_path: Path) -> None:
    def chained_body(seq: int, prev: str, own: str) -> dict[str, object]:
        return {"journal_seq": seq, "prev": prev, "hash": own}

    with SiteStore(tmp_path / "s.sqlite") as store:
        assert (
            store.add_events(
                [received_event(1, chained_body(1, "", "a")), received_event(2, chained_body(2, "a", "b"))]
            )
            == []
        )
        assert "another event under the number 1" in store.add_events([received_event(1, raw=b"other")])[0]
        assert "rewritten" in store.add_events([received_event(3, chained_body(3, "x", "c"))])[0]
        assert (
            store.add_events([received_event(1, chained_body(1, "", "a"), epoch="e2")]) == []
        )  # the same, from a new outbox
        assert "rewritten" in store.add_events([received_event(2, chained_body(2, "a", "y"), epoch="e2")])[0]


# journal


def test_the_tail_follows_while_the_journal_is_written_and_cannot_write_it(tmp_path: Path) -> None:
    tail = JournalTail(tmp_path / "journal.db")
    assert tail.events_after(0) == []
    (tmp_path / "journal.db").touch()  # its writer has opened it and not come to the table yet
    assert (tail.events_after(0), tail.trouble) == ([], "")
    with Journal.open_file(tmp_path / "journal.db") as journal:
        journal.append("r-1", "finding", {"value": 0.1})
        first = tail.events_after(0)
        journal.append("r-1", "finding", {"value": "ü"})
        assert [event.seq for event in (*first, *tail.events_after(1))] == [1, 2]
        assert chain_flaw(event_to_json(first[0])) == ""
        assert "not what its hash says" in chain_flaw(event_to_json(first[0]) | {"actor": "another person"})
        assert tail._database is not None
        with pytest.raises(sqlite3.OperationalError, match="readonly"):
            tail._database.execute("DELETE FROM event")
    tail.close()


@pytest.mark.parametrize("damage", ["body = '{'", "body = '{}'", "kind = 'other'", "wall_utc = ''"])
def test_the_tail_tells_of_a_damaged_event_and_stops_before_it(tmp_path: Path, damage: str) -> None:
    tail = JournalTail(tmp_path / "journal.db")
    with Journal.open_file(tmp_path / "journal.db") as journal:
        for number in range(3):
            journal.append(f"r-{number}", "run_started", {"procedure": "p", "cell": {"devices": []}})
    with closing(sqlite3.connect(tmp_path / "journal.db")) as database, database:
        database.execute(f"UPDATE event SET {damage} WHERE seq = 2")
    ledger = SiteLedger()
    for event in tail.events_after(0):
        ledger.take_event(event)
    assert (ledger.head, tail.events_after(1)) == (1, [])
    assert tail.trouble == "the journal is damaged after event 1: event 2 is not what was written"
    tail.close()


def test_the_ledger_knows_the_last_certificate_and_the_trend(tmp_path: Path) -> None:
    ledger, journal = SiteLedger(), Journal.open_file(tmp_path / "j.db")
    header = {"procedure": "drift_check", "cell": {"devices": [{"identity": {"serial": "F-1"}}]}}
    finding = {"change_rms_m": 0.00012, "change_max_m": 0.0004}
    for run, verdict, result in (
        ("d-1", "passed", {"look": {"finding": finding}}),
        ("d-2", "passed", {"look": None}),
        ("d-3", "refused", None),
        ("d-4", "cancelled", None),
    ):
        journal.append(run, "run_started", header)
        body = {"verdict": verdict, "reason": "", "result": result, "judgement": {"word": "pass"}}
        journal.append(run, "run_ended", body)
    for event in journal.list_events():
        ledger.take_event(event)
    journal.close()
    assert [entry["change_rms_m"] for entry in ledger.drift] == [0.00012]
    assert ledger.certificate is not None
    assert (ledger.certificate["run_id"], ledger.certificate["word"]) == ("d-3", "refused")
    assert [run["run_id"] for run in ledger.list_runs()] == ["d-4", "d-3", "d-2", "d-1"]


def test_a_run_without_an_end_is_running_while_a_process_has_it(tmp_path: Path) -> None:
    ledger = SiteLedger()
    with closing(Journal.open_file(tmp_path / "j.db")) as journal:
        for run in ("d-1", "d-2"):
            journal.append(run, "run_started", {"procedure": "drift_check", "cell": {"devices": []}})
        for event in journal.list_events():
            ledger.take_event(event)
    answers = CellAnswers(tmp_path / "j.db", tmp_path, tmp_path, ledger, leases=tmp_path / "leases")
    with acquire_lease(tmp_path / "leases", "F-1", "a run (d-2)"):
        (told,) = answers.answer_query("runs", {})
    assert isinstance(told, dict)
    assert {run["run_id"]: run["state"] for run in told["runs"]} == {"d-1": "interrupted", "d-2": "running"}


def test_certificates_are_looked_for_where_they_are_kept(tmp_path: Path) -> None:
    config = read_cell_file(write_cell_file(tmp_path, "127.0.0.1", seed=1, time_factor=1.0))
    folder = certificates_folder(config)
    assert folder == config.cell.data_dir / CERTIFICATES
    folder.mkdir(parents=True)
    (folder / "run-1-refused.json").write_text("refused")
    (tmp_path / "data" / "signing_key.json").write_text("secret")
    answers = CellAnswers(
        tmp_path / "none", tmp_path / "none", folder, SiteLedger(), leases=tmp_path / "leases"
    )
    assert answers.read_certificate("run-1") == b"refused"
    for name in ("run-2", "../signing_key", "", "a/b", "run-1\x00"):
        with pytest.raises(CellError, match="no certificate"):
            answers.read_certificate(name)


# alarms and presence


def test_a_device_that_flaps_is_one_alarm() -> None:
    alarms, wrong = AlarmSet(), [CellAlarm("device.stopped", "fanuc", "E-stop.")]
    changes = [alarms.update_alarms(wrong if k % 2 else [], k * 0.5) for k in range(1, 12)]
    assert [raised for change in changes for _, raised in change] == [True]
    assert alarms.update_alarms([], 6.0 + STEADY_S) == [(wrong[0], False)]


def test_what_is_wrong_is_read_from_the_desks_own_words() -> None:
    assert list_alarms(session_of("c"), live_of()) == []
    loss = {"robot": "fanuc", "what": "lost", "detected_by": "epoch", "words": "battery"}
    found = list_alarms(
        session_of("c", losses=[loss], connection={"connected": False, "message": "no cable", "remedy": "x"}),
        live_of(state="stopped"),
    )
    assert [alarm.code for alarm in found] == ["cell.unreachable", "position.lost", "device.stopped"]
    assert list_alarms(None, None) == []


def test_online_needs_a_state_that_was_opened_and_is_new(tmp_path: Path) -> None:
    key = station_key(tmp_path)
    fleet = Fleet(
        StationsFile(
            site="s",
            cells={"c": EnrolledCell(public_key=key.public_key, enrolled_utc="2026-01-01T00:00:00Z")},
        )
    )
    state = {"cell": "c", "alarms": [], "run": None, "asks": None, "attended": True, "drift": []}
    state |= {"certificate": None, "due": [], "outbox": {"first": 1, "last": 0}}
    name, sealer = "cellcal/v1/s/c/state", MessageSigner(key, "c", "e")

    def link_state(now_s: float) -> str:
        fleet.open_newest_states()
        return fleet.cell_views(now_s)[0].link

    assert link_state(0.0) == "never"
    for _ in range(2):
        fleet.note_liveliness("cellcal/v1/s/c/alive", alive=True)  # a double changes nothing
    assert link_state(0.0) == "silent"
    fleet.take_sample(name, sealer.sign_message(name, 2, state), 1.0)
    assert link_state(1.5) == "online"
    assert link_state(1.6 + SILENT_S) == "silent"  # the cable was pulled: no connection was closed
    fleet.take_sample(name, sealer.sign_message(name, 1, state), 9.0)
    assert link_state(9.0) == "silent"  # an old one, said again
    fleet.take_sample(name, b"{}", 9.0)
    assert link_state(9.0) == "silent"
    assert fleet.flaw_count == 1
    fleet.take_sample("cellcal/v1/s/other/state", b"{}", 9.0)
    fleet.note_liveliness("cellcal/v1/s/c/alive", alive=False)
    assert link_state(9.0) == "offline"
    for k in range(1000):
        fleet.take_sample(f"cellcal/v1/s/c/device/{k}/value", b"{}", 9.0)
    assert len(fleet._stations["c"].waiting) <= 200
