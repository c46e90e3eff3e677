"""Templates and arguments beside a JSON document: a table by the English texts that stand in the document.

The document itself holds finished English, for everything that reads it without a catalogue. Its table is an object
of its own, under the key `MESSAGES`::

    {"reason": "no answer within 2.0 s.",
     "messages": {"no answer within 2.0 s.": {"template": "no answer within {limit_s} s.",
                                              "arguments": {"limit_s": "2.0"}}}}

An argument is a text, or the template and arguments of a message. An entry counts only if its template and arguments
give exactly the English text: a table can translate a document, never change what it says.
"""

from collections.abc import Iterator, Mapping
from typing import Any

from cellcal.calibration.message import (
    Argument,
    Message,
    MessageSource,
    find_message,
    remember_message,
)
from cellcal.calibration.renamed_holes import rename_holes

MESSAGES = "messages"
_DEEPEST = 20  # messages inside of messages


def with_messages(document: Any, find: MessageSource = find_message) -> Any:
    """Return a JSON document with the table of its messages; a list of objects with a table in each object.

    A document without such texts is returned as it is.
    """
    if isinstance(document, list):
        return [with_messages(each, find) for each in document]
    if not isinstance(document, dict):
        return document
    table = collect_messages(document, find)
    return {**document, MESSAGES: document.get(MESSAGES, {}) | table} if table else document


def collect_messages(document: Any, find: MessageSource = find_message) -> dict[str, Any]:
    """Return template and arguments of every text of a document that was made of a message, by the text."""
    found = ((text, find(text)) for text in texts_of(document))
    return {text[:]: write_message(made) for text, made in found if made is not None}


def remember_table(document: Any) -> None:
    """Have `find_message` find the messages of a document's table."""
    table = document.get(MESSAGES) if isinstance(document, Mapping) else None
    for text, entry in table.items() if isinstance(table, Mapping) else ():
        if (made := read_message(text, entry)) is not None:
            remember_message(made)


def take_table(document: Any) -> Any:
    """Have `find_message` find the messages of a document; return the document without its table."""
    remember_table(document)
    return {name: each for name, each in document.items() if name != MESSAGES}


def write_message(made: Message) -> dict[str, Any]:
    """Return a message as its entry in a table."""
    arguments = {
        name: write_message(each) if isinstance(each, Message) else each
        for name, each in made.arguments.items()
    }
    return {"template": made.template, "arguments": arguments}


def read_message(text: str, entry: Any) -> Message | None:
    """Return the message of an entry; None if it is malformed or gives another text."""
    try:
        made = _read_entry(entry)
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return None
    return made if made == text and text not in made.arguments.values() else None


def _read_entry(entry: Any, depth: int = 0) -> Message:
    if depth > _DEEPEST:
        raise ValueError("messages inside of messages without end")
    template, written = rename_holes(entry["template"], entry["arguments"])
    arguments = {str(name): _read_argument(each, depth) for name, each in written.items()}
    return Message.from_template(template, arguments)


def _read_argument(written: Any, depth: int) -> Argument:
    if isinstance(written, str):
        return written
    return _read_entry(written, depth + 1)


def texts_of(document: Any) -> Iterator[str]:
    """Yield every text of a document except those of its table, and the names of its fields."""
    waiting = [document]
    while waiting:
        each = waiting.pop()
        if isinstance(each, str):
            yield each
        elif isinstance(each, Mapping):
            for name, value in each.items():
                if name != MESSAGES:
                    yield name
                    waiting.append(value)
        elif isinstance(each, list | tuple):
            waiting.extend(each)
