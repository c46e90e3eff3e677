"""A text for people that keeps its English template and its arguments, so that it can be translated later.

A `Message` is the finished English text. What writes, compares or logs texts treats it as the ``str`` that it is;
what shows it to a reader looks up its template in a catalogue and fills in the arguments in the reader's language::

    make_message("no answer from {device} within {limit_s:.1f} s", device="probe", limit_s=2)

is ``"no answer from probe within 2.0 s"``, of the template ``"no answer from {device} within {limit_s} s"``: the
format of a number belongs to the argument, and the template in a catalogue has none.

A text that passes through JSON or a validating model is a plain ``str`` afterwards. `find_message` returns the
message that was made of it in this process: a template and its arguments are identified by the English text that
they give.
"""

from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from string import Formatter
from types import MappingProxyType
from typing import TypeAlias

_MOST_REMEMBERED = 32_768  # messages in each of the two generations of `_RecentMessages`
_FORMATTER = Formatter()
_LINE_ENDS = (0x0B, 0x0C, 0x0D, 0x85, 0x2028, 0x2029)
_REPLACED = "\N{REPLACEMENT CHARACTER}"
_OBEYED: dict[int, str] = dict.fromkeys(  # controls, letters without width, directions, halves of a pair
    (
        *range(0x20), *range(0x7F, 0xA0), 0x200B, 0x200E, 0x200F, *range(0x202A, 0x202F),
        *range(0x2060, 0x206A), 0xFEFF, *range(0xD800, 0xE000),
    ),
    _REPLACED,
)  # fmt: skip
_AS_LINES = {**_OBEYED, 0x09: "\t", **dict.fromkeys((0x0A, *_LINE_ENDS), "\n")}
_AS_ONE_LINE = {**_OBEYED, **dict.fromkeys((0x09, 0x0A, *_LINE_ENDS), " ")}


class Message(str):
    """A finished English text with its template and arguments."""

    __slots__ = ("arguments", "template")
    template: str
    arguments: Mapping[str, "Argument"]

    def __new__(cls, text: str, template: str, arguments: Mapping[str, "Argument"]) -> "Message":
        """Return the message; `from_template` and `make_message` derive the text."""
        made = super().__new__(cls, text)
        made.template = template
        made.arguments = MappingProxyType(dict(arguments))
        return made

    @classmethod
    def from_template(cls, template: str, arguments: Mapping[str, "Argument"]) -> "Message":
        """Return the message of a template without formats and its finished arguments.

        Raises
        ------
        KeyError
            An argument is missing.
        ValueError
            The template is malformed.
        """
        return cls(fill_template(template, arguments), template, arguments)

    def __str__(self) -> str:
        """Return the message itself: the text of an exception keeps template and arguments."""
        return self

    def __format__(self, format_spec: str) -> str:
        """Return the message itself unless a format is requested."""
        return super().__format__(format_spec) if format_spec else self

    def __reduce__(self) -> tuple[object, ...]:
        """Return what another process makes the same message of."""
        return _restore_message, (self[:], self.template, dict(self.arguments))


Argument: TypeAlias = str | Message
MessageSource: TypeAlias = Callable[[str], Message | None]  # the message that has a text


class _RecentMessages:
    """The newest messages of this process by their text, in two generations: the older one is dropped when full."""

    def __init__(self) -> None:
        self._new: dict[str, Message] = {}
        self._old: dict[str, Message] = {}

    def add(self, made: Message) -> None:
        """Remember a message; of two with the same text the newer one."""
        if len(self._new) >= _MOST_REMEMBERED:
            self._old, self._new = self._new, {}
        self._new[made] = made

    def find(self, text: str) -> Message | None:
        """Return the message with a text; it becomes one of the newest."""
        found = self._new.get(text)
        if found is None and (found := self._old.get(text)) is not None:
            self.add(found)
        return found


_RECENT = _RecentMessages()


def make_message(template: str, /, *numbered: object, **named: object) -> str:
    """Return the English text of a template, a `Message`: it keeps template and arguments.

    A hole of the template is ``{name}``, ``{name:format}`` or ``{name!r}`` as in an f-string, with a plain name, or
    ``{}``; these are named 1, 2 and so on. An argument may be a message, or an exception that was raised with one.
    Where the text is that of an argument, the argument is returned: no message has its own text as an argument.
    """
    plain, holes = _parse_template(template)
    arguments = {str(place): value for place, value in enumerate(numbered, start=1)} | named
    made = Message.from_template(
        plain, {name: _finish_argument(arguments[name], *how) for name, *how in holes}
    )
    for argument in made.arguments.values():
        if argument == made:  # all else is empty: the text is its argument's
            return argument
    remember_message(made)
    return made


def join_messages(separator: str, texts: Iterable[object]) -> str:
    """Return texts one after the other, a `Message`: each keeps its template and arguments."""
    parts = {f"part_{place}": text for place, text in enumerate(texts, start=1)}
    if len(parts) < 2:
        return str(parts.get("part_1", ""))
    return make_message(escape_braces(separator).join(f"{{{name}}}" for name in parts), **parts)


def limit_to_line(text: str, most: int) -> str:
    """Return a text with all that a device put into it in one line of at most ``most`` characters each.

    What a terminal would obey becomes U+FFFD: an answer must not clear a screen or write a line that looks like ours.
    Templates are our own and stay as they are, so a message can still be translated.
    """
    if len(text) <= most and text.isprintable():
        return text
    message = find_message(text)
    if message is None:
        line = text[: most + 1].replace("\r\n", "\n").translate(_AS_ONE_LINE)
        return line if len(line) <= most else f"{line[: most - 1]}…"
    arguments = {name: limit_to_line(value, most) for name, value in message.arguments.items()}
    if arguments == message.arguments:
        return message
    limited = Message.from_template(message.template, arguments)
    remember_message(limited)
    return limited


def without_controls(text: str) -> str:
    """Return a text with its lines, and with U+FFFD for what a terminal would obey."""
    if text.isprintable():
        return text
    return text.replace("\r\n", "\n").translate(_AS_LINES)


def find_message(text: str) -> Message | None:
    """Return the message that has this English text; None where it is plain, or too old to be remembered."""
    return text if isinstance(text, Message) else _RECENT.find(text)


def remember_message(made: Message) -> None:
    """Have `find_message` find a message, also one that another process or a journal supplied."""
    _RECENT.add(made)


def fill_template(template: str, arguments: Mapping[str, str]) -> str:
    """Return a template, in any language, with its holes filled in.

    Raises
    ------
    KeyError
        An argument is missing.
    ValueError
        The template is malformed.
    """
    return "".join(
        literal if name is None else literal + arguments[name] for literal, name in split_template(template)
    )


def escape_braces(text: str) -> str:
    """Return a text as a template has it."""
    return text.replace("{", "{{").replace("}", "}}")


@lru_cache(maxsize=4096)
def split_template(template: str) -> tuple[tuple[str, str | None], ...]:
    """Return each literal of a template with the name of the hole behind it, None behind the last one."""
    return tuple((literal, name) for literal, name, _, _ in _FORMATTER.parse(template))


@lru_cache(maxsize=4096)
def _parse_template(template: str) -> tuple[str, tuple[tuple[str, str, str], ...]]:
    """Return a template without formats, and name, conversion and format of each hole."""
    plain: list[str] = []
    holes: list[tuple[str, str, str]] = []
    for literal, name, format_spec, conversion in _FORMATTER.parse(template):
        plain.append(escape_braces(literal))
        if name is not None:
            called = name or str(1 + sum(each.isdigit() for each, _, _ in holes))
            plain.append(f"{{{called}}}")
            holes.append((called, conversion or "", format_spec or ""))
    return "".join(plain), tuple(holes)


def _finish_argument(value: object, conversion: str, format_spec: str) -> Argument:
    if conversion == "r":
        return format(repr(value), format_spec)
    text = format(value, format_spec)
    return find_message(text) or text


def _restore_message(text: str, template: str, arguments: Mapping[str, Argument]) -> Message:
    made = Message(text, template, arguments)
    remember_message(made)
    return made
