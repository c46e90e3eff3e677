"""Templates and arguments on every way: journal, process of the cell, WebSocket, HTTP."""

import json
from pathlib import Path
from typing import Any

import pytest

from cellcal.calibration.errors import CellError
from cellcal.calibration.message import Message, find_message, make_message
from cellcal.procedures.run_history import EventKind
from cellcal.service.cell_process.lines import LineWriter
from cellcal.service.path_redaction import without_paths
from cellcal.service.record.journal import Journal
from cellcal.service.runs.journal_ledger import JournalLedger
from cellcal.service.translation import Translations
from cellcal.service.web.error_responses import respond_to_error
from cellcal.service.web.websocket_hub import encode_message

TEMPLATE = "{path} gives {found} of {whole} m."


def text_about(path: str, found: float) -> str:
    return make_message("{path} gives {found:.2f} of {whole:g} m.", path=path, found=found, whole=3)


def entry_of(document: Any, text: str) -> Any:
    return document["messages"][text]


def test_the_journal_keeps_templates_beside_the_english(tmp_path: Path) -> None:
    text = text_about("a.csv", 1.0)
    with Journal(tmp_path / "journal.db") as journal:
        ledger = JournalLedger(journal, "run-1", "service")
        ledger.record(EventKind.FAILED, {"step": "measure", "message": text}, key="measure/1/failed")
        ledger.record(EventKind.FAILED, {"step": "plain", "message": "no figure"}, key="plain/1/failed")
        first, second = (json.loads(event.body) for event in journal.list_events("run-1"))
    assert first["message"] == "a.csv gives 1.00 of 3 m."
    assert entry_of(first, first["message"]) == {
        "template": TEMPLATE,
        "arguments": {"path": "a.csv", "found": "1.00", "whole": "3"},
    }
    assert second == {"step": "plain", "message": "no figure"}


def test_the_same_fact_is_stored_once_whether_its_template_is_known_or_not(tmp_path: Path) -> None:
    text = text_about("b.csv", 1.0)
    with Journal(tmp_path / "journal.db") as journal:
        JournalLedger(journal, "run-1", "service").record(EventKind.FAILED, {"message": text}, key="once")
        again = journal.append("run-1", EventKind.FAILED, {"message": text[:]}, key="once")
        assert len(journal.list_events("run-1")) == 1
        assert "messages" in json.loads(again.body)


def test_lines_of_the_cell_s_process_and_of_the_websocket_carry_templates() -> None:
    text = text_about("c.csv", 2.0)
    line = json.loads(LineWriter().line_of({"told": "session", "content": {"run": {"reason": text}}}))
    shown = json.loads(encode_message("session", {"run": {"reason": text}}))
    for document in (line, shown):
        assert document["content"]["run"]["reason"] == "c.csv gives 2.00 of 3 m."
        assert entry_of(document, text)["template"] == TEMPLATE


def test_a_refusal_names_no_folder_and_keeps_its_template() -> None:
    error = CellError(text_about("/srv/cell/data/d.csv", 2.5), remedy="Look at it.", code="x")
    answer = json.loads(bytes(respond_to_error(None, error).body))  # type: ignore[arg-type]
    assert answer["message"] == "d.csv gives 2.50 of 3 m."
    assert entry_of(answer, answer["message"])["arguments"]["path"] == "d.csv"


def test_a_text_without_a_path_stays_the_message_that_it_is() -> None:
    found = without_paths(text_about("e.csv", 0.5))
    assert isinstance(found, Message)
    assert find_message("e.csv gives 0.50 of 3 m.") == found


@pytest.mark.parametrize(("template", "chinese"), [("{why}.", "{0}。"), ("{why}; {then}.", "{0}\uff1b{1}。")])
def test_chinese_sentences_that_are_only_filled_in_end_with_its_own_stop(template: str, chinese: str) -> None:
    table = {"the wire is slack": "拉线松弛", "the hook is off": "挂钩脱落"}
    names = {"why": "the wire is slack", "then": "the hook is off"}
    text = make_message(template, **{name: names[name] for name in names if f"{{{name}}}" in template})
    assert Translations("zh", table).translate(text) == chinese.format(*table.values())
    assert Translations("de", {key: key.upper() for key in table}).translate(text).endswith(".")


def test_a_chinese_part_that_begins_with_a_mark_has_no_space_before_it() -> None:
    part = make_message(" with {other}", other="J2 d")
    text = make_message("{parameter} cannot be told{partner}", parameter="J1 d", partner=part)
    table = {
        "{parameter} cannot be told{partner}": "无法确定 {parameter}{partner}",
        "with {other}": "\uff0c连同 {other}",
    }
    assert Translations("zh", table).translate(text) == "无法确定 J1 d\uff0c连同 J2 d"


@pytest.mark.parametrize("axes", ["1, 2, 3", "axes 1, 2, 3", "2"])
def test_a_list_of_numbers_in_a_sentence_is_no_numbered_step(axes: str) -> None:
    text = make_message("the motors of {axes} are lost", axes=axes)
    table = {"the motors of {axes} are lost": "verloren: {axes}"}
    assert Translations("de", table).translate(text) == f"verloren: {axes}"
