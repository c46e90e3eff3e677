"""Who accepted, approved and signed what, in which role and when: from the screen through the journal to paper."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.procedures.run_history import EventKind
from cellcal.service.cell_process.cell_controller import CellController
from cellcal.service.cell_process.messages import AnswerPrompt, SessionCommand, Signer, SignOff, StartRun
from cellcal.service.cell_process.run_status import RunStatus
from cellcal.service.cell_process.signer_roles import SignerRoles
from cellcal.service.certificates.certificate import issue_certificate
from cellcal.service.certificates.page_sections import page_of
from cellcal.service.certificates.printing import html_from, pdf_from
from cellcal.service.certificates.text import as_text
from cellcal.service.cli.runs import show
from cellcal.service.configuration.cell_file import CellConfig
from cellcal.service.people.authentication import LOCAL_PERSON, Person
from cellcal.service.people.authorization import OrderAuthorizer
from cellcal.service.people.errors import SecondPersonError
from cellcal.service.people.roles import Role
from cellcal.service.record.journal import Journal
from cellcal.service.record.journal_files import certificates_folder, open_journal
from cellcal.service.record.run_store import RunStore
from cellcal.service.record.signing import CheckFinding, check_document
from tests.procedures.certified_runs import cell_config, run_in
from tests.procedures.procedure_scenes import recovery_scene, user_frame_scene
from tests.service.printed_documents import HtmlText, PdfReader, squeeze_text, verify_paper

HEADING = "Accepted, approved and signed"
LINE = "Safety functions that depend on the robot's position"


def sign_run(config: CellConfig, run_id: str, who: str, lines: list[str]) -> None:
    with open_journal(config) as journal:
        journal.append(run_id, EventKind.SIGNED, {"who": who, "lines": lines}, key="signed", actor=who)


def content_in(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_bytes())["content"]
    return found


async def test_a_second_persons_signature_stands_on_all_four_forms(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, await recovery_scene(), "mastering_recovery")
    before = issue_certificate(config, outcome.run_id)
    certificate_bytes = before.json_path.read_bytes()
    lines = tuple(content_in(before.json_path)["verdict"]["to_sign"])
    line = next(line for line in lines if LINE in line)
    assert "Signature ____" in before.text_path.read_text()
    command = SessionCommand(
        id="1", rev=1, who="Zoë Ångström-O'Neil", people=(Signer(name="Zoë Ångström-O'Neil", role="engineer"),),
        order=SignOff(op="sign", run_id=outcome.run_id, lines=lines),
    )  # fmt: skip
    await SignerRoles(config).note_signers(outcome.run_id, command)
    sign_run(config, outcome.run_id, command.who, list(lines))

    after = issue_certificate(config, outcome.run_id)
    raw = after.json_path.read_bytes()
    assert check_document(raw, expected_key=after.key.public_key).finding is CheckFinding.INTACT
    assert (
        check_document(certificate_bytes, expected_key=after.key.public_key).finding is CheckFinding.INTACT
    )  # a copy from before stays good
    sign_off = content_in(after.json_path)["sign_off"]
    last = next(one for one in sign_off if one["what"] == line)
    assert (last["did"], last["who"]) == ("signed", "Zoë Ångström-O'Neil")
    assert last["people"] == [{"name": "Zoë Ångström-O'Neil", "role": "engineer"}]
    accepted = {one["what"]: one for one in sign_off if one["did"] == "accepted"}
    assert accepted["accept the correction"]["who"] == "anna"
    assert len(accepted["accept the correction"]["what_sha256"]) == 64
    verify_paper(after.json_path)
    html = HtmlText.read_html(html_from(after.json_path)).text
    for form in (html, PdfReader(pdf_from(after.json_path)).read_text(), after.text_path.read_text()):
        form_text = squeeze_text(form)
        assert squeeze_text(HEADING) in form_text
        assert squeeze_text(f"signed: {line}") in form_text
        assert "Zoë" in form_text
        assert "engineer" in form_text
        assert squeeze_text("accepted: accept the correction") in form_text
        assert last["at_utc"][:10] in form_text
    assert "Signature ____" not in after.text_path.read_text()  # nothing is left to be signed by hand


async def test_one_changed_name_in_the_sign_off_is_found_offline(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, await recovery_scene(), "mastering_recovery")
    line = outcome.judgement["to_sign"][0]
    sign_run(config, outcome.run_id, "Berta", [line])
    issued = issue_certificate(config, outcome.run_id)
    raw = issued.json_path.read_bytes()
    assert raw.count(b'"Berta"') == 1
    forged = raw.replace(b'"Berta"', b'"Bertl"')
    assert check_document(forged, expected_key=issued.key.public_key).finding is CheckFinding.TAMPERED


async def test_a_certificate_from_before_signing_was_printed_still_verifies_and_prints(
    tmp_path: Path,
) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    issued = issue_certificate(config, outcome.run_id)
    old = content_in(issued.json_path)
    del old["sign_off"]
    raw = issued.key.sign_document("cellcal certificate 1", old).encode()
    checked = check_document(raw, expected_key=issued.key.public_key)
    assert checked.finding is CheckFinding.INTACT
    page = page_of(old, checked.sha256, checked.public_key)
    assert HEADING not in [section.title for section in page.sections]
    assert HEADING not in as_text(old, checked.sha256, checked.public_key)


async def test_roles_are_those_of_the_moment_and_are_noted_once(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    answering = SignerRoles(config)

    async def press_as(role: str) -> None:
        people = (Signer(name="Tom", role="technician"), Signer(name="Ben", role=role))
        order = AnswerPrompt(op="answer", prompt_id="1")
        command = SessionCommand(id="1", rev=1, who="Tom and Ben", people=people, order=order)
        await answering.note_signers(outcome.run_id, command)

    await press_as("technician")
    await press_as("technician")
    with open_journal(config) as journal:
        assert len(_noted_roles(journal, outcome.run_id)) == 1
        _approve_run(journal, outcome.run_id)
    await press_as("engineer")
    with open_journal(config) as journal:
        assert len(_noted_roles(journal, outcome.run_id)) == 2
        _approve_run(journal, outcome.run_id)
    sign_off = content_in(issue_certificate(config, outcome.run_id).json_path)["sign_off"]
    roles = [[p["role"] for p in one["people"]] for one in sign_off if one["who"] == "Tom and Ben"]
    assert roles == [["technician", "technician"], ["technician", "engineer"]]
    assert [one["people"] for one in sign_off if one["who"] == "anna"] == [
        []
    ]  # run from the console: no role is known
    text = issue_certificate(config, outcome.run_id).text_path.read_text()
    assert "by Tom and Ben (technician and engineer)" in text
    assert "by anna (role not recorded)" in text


async def test_the_starter_of_a_run_is_recorded_with_the_role_of_that_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, user_frame_scene(), "three_point_frame")
    answering = SignerRoles(config)
    with open_journal(config) as journal:
        assert RunStore(journal).find_run(outcome.run_id).begun_as == ()  # from the console: no role is known

    async def begin_run(who: str, role: str) -> None:
        order = StartRun(op="start", procedure="three_point_frame", settings={}, hold_to_move=False)
        people = (Signer(name=who, role=role),)
        await answering.note_signers("", SessionCommand(id=who, rev=1, who=who, people=people, order=order))
        answering.note_beginning(outcome.run_id, who)

    await begin_run("Tom", "technician")  # who goes on with it did not begin it
    with open_journal(config) as journal:
        assert RunStore(journal).find_run(outcome.run_id).begun_as == ()
    await begin_run("anna", "engineer")
    await begin_run("anna", "technician")
    with open_journal(config) as journal:
        run_view = RunStore(journal).find_run(outcome.run_id)
        assert len(_noted_roles(journal, outcome.run_id)) == 3
    assert (run_view.begun_by, run_view.begun_as) == ("anna", ("engineer",))
    assert show("last", cell=Path(config.path)) == 0
    assert "begun: anna (engineer), 20" in capsys.readouterr().out


def _noted_roles(journal: Journal, run_id: str) -> list[str]:
    return [event.body for event in journal.list_events(run_id) if event.kind == EventKind.ANSWERS_AS]


def _approve_run(journal: Journal, run_id: str) -> None:
    body = {"before": "go on", "key": "may_move", "who": "Tom and Ben", "text": "May it move?"}
    journal.append(run_id, EventKind.APPROVAL, body)


def test_authorization_resolves_a_name_to_its_account() -> None:
    permits, order = OrderAuthorizer(), AnswerPrompt(op="answer", prompt_id="q")
    session = {"rev": 1, "prompt": {"id": "q", "key": "accept_mastering"}}
    tom = Person("Tom", Role.TECHNICIAN, fresh_pin=True)
    with pytest.raises(SecondPersonError):
        permits.authorize(tom, "1", 1, order, session)
    both = permits.authorize(Person("Tina", Role.TECHNICIAN, fresh_pin=True), "2", 1, order, session)
    assert permits.signers_of(both) == [
        {"name": "Tom", "role": "technician"},
        {"name": "Tina", "role": "technician"},
    ]
    emil = permits.authorize(Person("Emil", Role.ENGINEER, fresh_pin=True), "3", 1, order, session)
    assert permits.signers_of(emil) == [{"name": "Emil", "role": "engineer"}]
    console = permits.authorize(LOCAL_PERSON, "4", 1, order, session)
    assert permits.signers_of(console)[0]["role"] == "console"
    assert permits.signers_of("unknown") == []


async def test_signing_writes_the_certificate_anew(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, await recovery_scene(), "mastering_recovery")
    issue_certificate(config, outcome.run_id)
    controller = CellController(config, lambda kind, content: None)
    ended = RunStatus(
        "mastering_recovery", "Mastering recovery", "Anna", run_id=outcome.run_id, state="ended"
    )
    ended.outcome = {"judgement": outcome.judgement}
    controller._runs.status = ended
    order = SignOff(op="sign", run_id=outcome.run_id, lines=tuple(outcome.judgement["to_sign"]))
    people = (Signer(name="Tina", role="technician"),)
    command = SessionCommand(id="1", rev=controller.rev, who="Tina", people=people, order=order)
    assert (await controller.execute_command(command))["ok"]
    assert (await controller.execute_command(command))["ok"]  # sent again after a lost link
    lies = certificates_folder(config) / f"{outcome.run_id}.json"
    signatures = [one for one in content_in(lies)["sign_off"] if one["did"] == "signed"]
    assert [one["what"] for one in signatures] == list(order.lines)
    assert {(one["who"], one["people"][0]["role"]) for one in signatures} == {("Tina", "technician")}
    assert "by Tina (technician)" in lies.with_suffix(".txt").read_text()
    assert "Tina" in lies.with_suffix(".html").read_text()


async def test_a_run_that_was_signed_says_so_after_every_reading_of_its_journal(tmp_path: Path) -> None:
    config = cell_config(tmp_path)
    outcome = await run_in(config, await recovery_scene(), "mastering_recovery")
    issue_certificate(config, outcome.run_id)
    sign_run(config, outcome.run_id, "Berta", list(outcome.judgement["to_sign"]))
    first = issue_certificate(config, outcome.run_id).json_path.read_bytes()
    assert issue_certificate(config, outcome.run_id).json_path.read_bytes() == first
    assert (certificates_folder(config) / f"{outcome.run_id}.json").read_bytes() == first
    with open_journal(config) as journal:
        assert RunStore(journal).find_run(outcome.run_id).state == "passed"
