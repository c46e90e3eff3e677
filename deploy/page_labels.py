"""Write the names that pages have of procedures and of their settings: `make types`. A test finds them stale."""

import json
import sys
from collections.abc import Mapping
from pathlib import Path

from cellcal.procedures.catalogue_index import CATALOGUE_INDEX
from cellcal.service.runs.settings_description import schema_of

_FOLDER = Path(__file__).parents[1] / "web" / "src" / "lib"
TITLES, LABELS = _FOLDER / "procedure_titles.json", _FOLDER / "setting_labels.json"
_OWN_FIELDS = frozenset(("Pose",))  # drawn as a place and a turn


def procedure_titles() -> dict[str, str]:
    """Return the titles of procedures by their names, in the order of lists."""
    return {entry.name: entry.title for entry in CATALOGUE_INDEX}


def setting_labels() -> dict[str, str]:
    """Return the labels of settings that messages may name; empty where settings of one name have several."""
    labels: dict[str, set[str]] = {}
    for entry in CATALOGUE_INDEX:
        schema = schema_of(entry.name, {})
        parts = [part for name, part in schema.get("$defs", {}).items() if name not in _OWN_FIELDS]
        for part in (schema, *parts):
            for name, field in part.get("properties", {}).items():
                if "_" in name:
                    labels.setdefault(name, set()).add(field["title"])
    return {name: found.pop() if len(found) == 1 else "" for name, found in sorted(labels.items())}


def _write_json(path: Path, content: Mapping[str, str]) -> None:
    path.write_text(json.dumps(content, ensure_ascii=False, indent=2) + "\n", encoding="utf-8")
    sys.stderr.write(f"{path} is written.\n")


if __name__ == "__main__":
    _write_json(TITLES, procedure_titles())
    _write_json(LABELS, setting_labels())
