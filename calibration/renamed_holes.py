"""Messages that were recorded with numbered names of their holes (``{serial_2}``), brought to the names of today.

Journals, signed certificates and messages between computers keep template and arguments. The English text is the
same with either names.
"""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from string import Formatter
from typing import TypeVar, cast

from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_text

Value = TypeVar("Value")

_NUMBERED = "_2}"  # each of these sentences has a hole of this name


@cache
def renamed_holes() -> Mapping[str, Mapping[str, str]]:
    """Return the new names of holes by the old ones, by the sentence that was recorded."""
    text = read_plain_text(Path(__file__).with_name("renamed_holes.json"))
    return cast(Mapping[str, Mapping[str, str]], parse_json(text))


def rename_holes(template: str, arguments: Mapping[str, Value]) -> tuple[str, Mapping[str, Value]]:
    """Return a recorded template and its arguments with the names of today."""
    if _NUMBERED not in template:
        return template, arguments
    renamed = dict(arguments)
    for sentence, names in renamed_holes().items():
        if sentence in template:
            template = template.replace(sentence, _rename_in(sentence, names))
            renamed |= {new: arguments[old] for old, new in names.items() if old in arguments}
    holes = {name for _, name, _, _ in Formatter().parse(template)}
    return template, {name: value for name, value in renamed.items() if name in holes}


def _rename_in(sentence: str, names: Mapping[str, str]) -> str:
    for old, new in names.items():
        sentence = sentence.replace(f"{{{old}}}", f"{{{new}}}")
    return sentence
