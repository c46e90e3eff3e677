"""What a command line gives a run: its settings, and a file that answers in a person's place."""

from pathlib import Path
from typing import Any

from cellcal.calibration.documents import DocumentError
from cellcal.calibration.documents.json_text import parse_json
from cellcal.calibration.documents.plain_files import read_plain_bytes


def settings_of(pairs: tuple[str, ...]) -> dict[str, object]:
    """Return KEY=VALUE pairs as a spec's settings; CellError for what is none, twice there or no finite number."""
    from cellcal.calibration.errors import CellError

    settings: dict[str, object] = {}
    for pair in pairs:
        key, separator, text = pair.partition("=")
        if not separator or not key:
            raise CellError(
                f"--set {pair!r} is not KEY=VALUE", remedy="For example --set tool_number=2.", code="usage"
            )
        if key in settings:
            raise CellError(f"--set {key} is given twice", remedy="Give each setting once.", code="usage")
        try:
            settings[key] = parse_json(text)
        except DocumentError:
            settings[key] = text
    return settings


def _refuse_constant(constant: str) -> Any:
    from cellcal.calibration.errors import CellError

    raise CellError(
        f"{constant} is not a number that a robot can use", remedy="Give a finite number.", code="usage"
    )


def operator_of(answers: Path | None) -> Any:
    """Return who answers: a person in the terminal, or the file that is given."""
    if answers is None:
        from cellcal.drivers.operator.terminal import TerminalOperator

        return TerminalOperator()
    from cellcal.drivers.operator.scripted import ScriptedOperator

    return ScriptedOperator(_read_answers(answers))


_MOST_ANSWERS = 1 << 20  # bytes


def _read_answers(path: Path) -> dict[str, str]:
    from cellcal.calibration.errors import CellError

    try:
        found = parse_json(read_plain_bytes(path, _MOST_ANSWERS))
    except ValueError as error:  # also what is no text
        found, why = None, f"is not JSON that holds answers: {str(error).rstrip('.')}"
    else:
        why = 'is not one object of texts, {"instruction key": "yes"}'
    if isinstance(found, dict) and all(isinstance(answer, str) for answer in found.values()):
        return found
    raise CellError(f"the answers {path}: the file {why}.", remedy="Correct --answers.", code="usage")
