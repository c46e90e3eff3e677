"""Messages: the English text, its template and arguments, through exceptions, JSON and other processes."""

import io
import pickle

import numpy as np
import orjson
import pytest
from pydantic import TypeAdapter
from rich.console import Console

from cellcal.calibration import message
from cellcal.calibration.errors import CellError
from cellcal.calibration.message import Message, find_message, join_messages, make_message
from cellcal.calibration.message_table import (
    MESSAGES,
    collect_messages,
    read_message,
    remember_table,
    take_table,
    with_messages,
    write_message,
)
from cellcal.drivers.errors import RefusedError, UnreachableError
from cellcal.drivers.interfaces import Alarm, Condition, Identity, Readiness
from cellcal.service.cli.printing import PlainTable


def message_for(text: str) -> Message:
    made = find_message(text)
    assert made is not None
    return made


@pytest.mark.parametrize(
    ("template", "arguments", "text", "plain"),
    [
        ("{a} of {b}", {"a": 1, "b": "x"}, "1 of x", "{a} of {b}"),
        ("{a:.2f} mm", {"a": np.float64(1.234)}, "1.23 mm", "{a} mm"),
        ("{a!r} is {{b}}", {"a": "x"}, "'x' is {b}", "{a} is {{b}}"),
        ("{a:>4}|{a:>4}", {"a": 7}, "   7|   7", "{a}|{a}"),
    ],
)
def test_a_message_is_what_an_f_string_would_be(
    template: str, arguments: dict[str, object], text: str, plain: str
) -> None:
    made = message_for(make_message(template, **arguments))
    assert made == text
    assert made.template == plain
    assert Message.from_template(made.template, made.arguments) == text


def test_holes_without_names_are_counted() -> None:
    made = message_for(make_message("{} holds {:.1f}", "a{1}", 2))
    assert made == "a{1} holds 2.0"
    assert (made.template, dict(made.arguments)) == ("{1} holds {2}", {"1": "a{1}", "2": "2.0"})


def test_a_missing_argument_is_refused() -> None:
    with pytest.raises(KeyError):
        make_message("{a} and {b}", a=1)


def test_an_error_inside_of_a_message_keeps_its_template() -> None:
    error = CellError(make_message("{n} touches are too few.", n=2), remedy="Teach three.")
    outer = message_for(make_message("probe: {error}", error=error))
    assert outer == "probe: 2 touches are too few. Teach three."
    inner = message_for(outer.arguments["error"])
    assert inner.template == "{part_1} {part_2}"
    assert message_for(inner.arguments["part_1"]).template == "{n} touches are too few."


def test_formatting_and_text_of_a_message_are_the_message() -> None:
    made = make_message("{n} points", n=3)
    assert f"{made}" is made
    assert str(ValueError(made)) is made
    assert f"{made:>10}" == "  3 points"
    assert not isinstance(f"{made:>10}", Message)


def test_a_text_that_is_nothing_but_its_argument_is_that_argument() -> None:
    """Its translation would otherwise be looked up in itself for ever."""
    inner = make_message("{n} points of it", n=5)
    assert make_message("{a}{b}", a=inner, b="") is inner
    assert join_messages("", (inner, "")) is inner
    assert make_message("{a}", a="plain words") == "plain words"
    assert find_message("plain words") is None
    own = {"template": "{a}{b}", "arguments": {"a": "its own text", "b": ""}}
    assert read_message("its own text", own) is None


def test_a_list_of_one_text_is_that_text() -> None:
    assert join_messages("; ", ()) == ""
    assert join_messages("; ", ("a",)) == "a"
    assert message_for(join_messages("; {", ("a", "b"))).template == "{part_1}; {{{part_2}"


def test_a_text_that_was_validated_is_still_known() -> None:
    made = make_message("{n} captures of {name}", n=12, name="wire")
    plain = TypeAdapter(str).validate_python(made)
    assert type(plain) is str
    assert find_message(plain) is made


def test_another_process_makes_the_same_message() -> None:
    made = message_for(make_message("{name} waits: {reason}", name="arm", reason=make_message("{n} s", n=4)))
    again = pickle.loads(pickle.dumps(made))
    assert again == made
    assert again.template == made.template
    assert again.arguments["reason"].template == "{n} s"


def test_the_newest_messages_are_known(monkeypatch: pytest.MonkeyPatch) -> None:
    assert message._MOST_REMEMBERED > 20_000  # rows that one file may leave out, each with its reason
    monkeypatch.setattr(message, "_MOST_REMEMBERED", 800)
    make_message("{number} begins a generation", number=0)
    made = make_message("the newest of {name}", name="all")
    for number in range(780):  # fewer than one generation, wherever it began
        make_message("{number} fills the memory", number=number)
    assert find_message("the newest of all") is made
    for number in range(2000):
        make_message("{number} fills it again", number=number)
    assert find_message("the newest of all") is None


def test_a_document_carries_its_messages_and_another_process_finds_them() -> None:
    reason = make_message(
        "{device} does not answer: {cause}", device="probe", cause=make_message("{n} V", n=0)
    )
    document = with_messages({"run": {"reasons": [reason, "plain"]}, "count": 1})
    sent = orjson.loads(orjson.dumps(document))
    assert sent["run"]["reasons"] == ["probe does not answer: 0 V", "plain"]
    assert list(sent[MESSAGES]) == ["probe does not answer: 0 V"]
    sent_text = "gauge does not answer: 1 V"
    other = {
        MESSAGES: {
            sent_text: write_message(
                message_for(make_message("{a} does {b}", a="gauge", b="not answer: 1 V"))
            )
        }
    }
    assert take_table({"reason": sent_text, **other}) == {"reason": sent_text}
    assert message_for(sent_text).template == "{a} does {b}"


def test_a_list_has_a_table_in_each_object_and_plain_documents_stay() -> None:
    reason = make_message("{n} of 3", n=2)
    assert with_messages([{"a": reason}, {"a": "plain words"}]) == [
        {"a": "2 of 3", MESSAGES: {"2 of 3": {"template": "{n} of 3", "arguments": {"n": "2"}}}},
        {"a": "plain words"},
    ]
    assert with_messages("text") == "text"


def test_a_table_collects_texts_but_not_those_of_its_own() -> None:
    inner = make_message("{n} counts inside", n=1)
    outer = make_message("outside: {inner}", inner=inner)
    assert list(collect_messages({"text": outer, MESSAGES: {inner: {}}})) == [outer]


@pytest.mark.parametrize(
    "entry",
    [
        {"template": "{n} of 4", "arguments": {"n": "2"}},  # another text
        {"template": "{n} of 3", "arguments": {}},
        {"template": "{n of 3", "arguments": {"n": "2"}},
        {"template": "{n.real} of 3", "arguments": {"n": "2"}},
        {"template": 3, "arguments": {"n": "2"}},
        {"template": "{n} of 3", "arguments": {"n": 2}},
        {"template": "{n} of 3", "arguments": [1]},
        "2 of 3",
        None,
    ],
)
def test_an_entry_that_does_not_give_the_text_is_ignored(entry: object) -> None:
    assert read_message("2 of 3", entry) is None


def test_a_table_that_is_none_is_ignored() -> None:
    remember_table({MESSAGES: ["x"]})
    remember_table(["x"])
    remember_table(None)


def test_messages_inside_of_messages_without_end_are_ignored() -> None:
    entry: dict[str, object] = {"template": "x", "arguments": {}}
    for _ in range(200):
        entry = {"template": "{a}", "arguments": {"a": entry}}
    assert read_message("x", entry) is None


def test_an_error_of_an_error_of_the_same_device_names_it_once() -> None:
    first = UnreachableError("robot", make_message("no answer from {address}.", address="10.0.0.1"))
    again = RefusedError("robot", first.message)
    assert again.message == "robot: no answer from 10.0.0.1."
    assert RefusedError("arm", first.message).message == "arm: robot: no answer from 10.0.0.1."


@pytest.mark.parametrize("letter", ["\x1b", "\x07", "\x9b", "\u202e", "\u200b", "\ud800"])
def test_what_a_device_sends_is_one_line_without_controls(letter: str) -> None:
    answer = f"go{letter}[2J\r\nrobot  UNCHANGED"
    plain = "go\N{REPLACEMENT CHARACTER}[2J robot  UNCHANGED"
    assert str(RefusedError("r", make_message("it said {reason}", reason=answer))) == f"r: it said {plain}"
    assert str(RefusedError("r", answer)) == f"r: {plain}"
    condition = Condition(Readiness.NOT_READY, make_message("in {mode}.", mode=answer))
    assert condition.message == f"in {plain}."
    assert message_for(condition.message).template == "in {mode}."
    assert Alarm(answer, answer) == Alarm(plain, plain)
    assert Identity("m", answer, answer, answer) == Identity("m", plain, plain, plain)


def test_what_a_device_sends_without_end_is_cut_and_the_sentence_around_it_stays() -> None:
    condition = Condition(
        Readiness.NOT_READY, make_message("the mode is {mode}, not AUTO.", mode="A" * 10**6)
    )
    assert condition.message.startswith("the mode is AAA")
    assert condition.message.endswith("…, not AUTO.")
    assert len(condition.message) < 500
    assert len(str(UnreachableError("r", "b" * 10**6))) < 1100
    sentence = make_message("the axes {axes} are lost: {more}", axes="1, 2", more="c" * 300)
    assert Condition(Readiness.NOT_READY, sentence).message is sentence


def test_a_table_of_the_terminal_obeys_nothing_that_a_file_or_device_says() -> None:
    out = Console(file=io.StringIO(), width=80, force_terminal=False)
    table = PlainTable("name", title="a\x1b[2Jb")
    table.add_row("cell\x1b[31m\x07 7\nsecond line")
    out.print(table)
    text = out.file.getvalue()  # type: ignore[attr-defined]
    assert not {"\x1b", "\x07"} & set(text)
    assert "a\N{REPLACEMENT CHARACTER}[2Jb" in text
    assert "second line" in text
