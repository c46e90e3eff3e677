"""Every setting of every procedure says what it is, in every language; a technician is asked for at most four."""

import json
import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import pytest

from cellcal.procedures.catalogue import DEFINITIONS
from cellcal.procedures.catalogue_index import CATALOGUE_INDEX
from cellcal.procedures.procedure_definition import NEEDS
from cellcal.procedures.procedure_guide import GUIDE, INTENTIONS, NEED_REMEDIES
from cellcal.procedures.setting_texts import GROUP_NAMES, MAX_BASIC, SettingGroup
from cellcal.service.configuration.file_settings import file_settings
from cellcal.service.runs.settings import spec_of
from cellcal.service.runs.settings_description import label_of, schema_of, settings_of

ROOT = Path(__file__).parents[2]
TRANSLATED = ("de", "es", "zh")
NAMES = [entry.name for entry in DEFINITIONS]
OWN_FIELDS = {"Pose"}  # drawn as a place and a turn
QUANTITIES = {"number", "integer"}
UNITS = {"m", "rad", "m/s", "rad/s", "count", "1"}
SENTENCE = re.compile(r"(?<=[.?!])\s+")
UNIT_ENDING = re.compile(r"_(m|rad|s|rad_s|m_s)$")
RAW_NAME = re.compile(r"\b[a-z]+_[a-z_]+\b")


def schema_parts(procedure: str) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the schema of a procedure's settings and of everything that is a part of one, by its name."""
    schema = schema_of(procedure, {})
    yield procedure, schema
    yield from ((name, part) for name, part in schema.get("$defs", {}).items() if name not in OWN_FIELDS)


def all_fields(procedure: str) -> Iterator[tuple[str, str, dict[str, Any]]]:
    for part, schema in schema_parts(procedure):
        for name, field in schema.get("properties", {}).items():
            yield part, name, field


def holds_number(schema: Any) -> bool:
    """Tell whether a value of this kind is a number or is made of numbers."""
    if not isinstance(schema, dict):
        return False
    inner = [schema.get("items"), *schema.get("anyOf", ()), *schema.get("prefixItems", ())]
    return schema.get("type") in QUANTITIES or any(holds_number(each) for each in inner)


def table(locale: str) -> dict[str, str]:
    found: dict[str, str] = json.loads(
        (ROOT / f"web/src/locales/settings/{locale}.json").read_text(encoding="utf-8")
    )
    return found


@pytest.mark.parametrize("procedure", NAMES)
def test_every_setting_has_a_label_a_sentence_a_unit_and_a_group(procedure: str) -> None:
    for part, name, field in all_fields(procedure):
        where = f"{procedure}: {part}.{name}"
        assert field.get("title"), where
        spelled = {name, UNIT_ENDING.sub("", name)}
        assert field["title"].lower().replace(" ", "_") not in spelled, f"{where} is called as it is spelled"
        assert not RAW_NAME.search(field["title"] + " " + field["description"]), where
        assert field["description"].endswith((".", ")")), where
        assert field["x-group"] in GROUP_NAMES.values(), where
        if holds_number(field):
            assert field["x-unit"] in UNITS, where


@pytest.mark.parametrize("procedure", NAMES)
def test_a_technician_is_asked_for_at_most_four_settings_and_for_all_that_must_be_given(
    procedure: str,
) -> None:
    schema = schema_of(procedure, {})
    basic = {name for name, field in schema["properties"].items() if field["x-basic"]}
    assert 1 <= len(basic) <= MAX_BASIC
    assert set(schema.get("required", ())) <= basic


@pytest.mark.parametrize("procedure", NAMES)
def test_no_form_calls_two_of_its_settings_the_same(procedure: str) -> None:
    for part, schema in schema_parts(procedure):
        counts = Counter(field["title"] for field in schema.get("properties", {}).values())
        assert [label for label, times in counts.items() if times > 1] == [], part


@pytest.mark.parametrize("procedure", NAMES)
def test_each_value_of_a_choice_has_words(procedure: str) -> None:
    for part, name, field in all_fields(procedure):
        assert set(field.get("enum", ())) == set(field.get("x-choices", ())), f"{part}.{name}"


@pytest.mark.parametrize("procedure", NAMES)
def test_a_place_or_direction_has_a_drawing(procedure: str) -> None:
    for part, name, field in all_fields(procedure):
        kinds = [field, *field.get("anyOf", ())]
        is_place = any(
            (kind.get("maxItems") == kind.get("minItems") == 3 and kind.get("type") == "array")
            or kind.get("$ref", "").endswith("/Pose")
            for kind in kinds
        )
        if is_place:
            assert (ROOT / f"web/public/places/{field['x-drawing']}.svg").exists(), f"{part}.{name}"


@pytest.mark.parametrize("locale", TRANSLATED)
def test_labels_sentences_groups_and_choices_are_translated(locale: str) -> None:
    words = table(locale)
    english = set(GROUP_NAMES.values())
    for procedure in NAMES:
        for _, _, field in all_fields(procedure):
            english |= {field["title"], *SENTENCE.split(field["description"])}
            english |= set(field.get("x-choices", {}).values())
    assert sorted(english - words.keys()) == []
    assert all(text.strip() for text in words.values())
    assert sorted(words.keys() - english) == [], "words that no setting has any more"


def test_groups_are_those_that_are_declared() -> None:
    assert set(GROUP_NAMES) == set(get_args(SettingGroup))


def test_the_terminal_tells_the_same_as_the_schema() -> None:
    for procedure in NAMES:
        properties = schema_of(procedure, {})["properties"]
        for setting in settings_of(procedure):
            field = properties[setting.name]
            assert (setting.label, setting.help_text) == (field["title"], field["description"])
            assert label_of(procedure, [setting.name]) == setting.label


def test_what_is_wrong_with_a_setting_is_said_with_its_label_and_its_name() -> None:
    with pytest.raises(Exception, match=r"Readings per pose \(samples\): Input should be greater"):
        spec_of("mastering_record", {"samples": 0})
    planes = [{"name": "floor", "point_in_base_m": [0, 0, 0]}]
    with pytest.raises(
        Exception, match="Floors, walls and tables · 1 · Direction away from the face"
    ) as fault:
        spec_of("mastering_record", {"room": {"surroundings": {"planes": planes}}})
    assert "(room.surroundings.planes.0.normal_in_base): must be given" in str(fault.value)


def test_the_guide_covers_the_catalogue_and_all_that_can_be_missing() -> None:
    assert GUIDE.keys() == set(NAMES)
    assert {entry.intention for entry in GUIDE.values()} == INTENTIONS.keys()
    assert NEED_REMEDIES.keys() == NEEDS.keys()
    for name in NAMES:
        assert (ROOT / f"web/public/procedures/{name}.svg").exists()


def test_pages_know_what_the_names_in_messages_are_called() -> None:
    labels: dict[str, set[str]] = {}
    for procedure in NAMES:
        for _, name, field in all_fields(procedure):
            if "_" in name:
                labels.setdefault(name, set()).add(field["title"])
    expected = {name: found.pop() if len(found) == 1 else "" for name, found in labels.items()}
    shown = json.loads((ROOT / "web/src/lib/setting_labels.json").read_text(encoding="utf-8"))
    assert shown == expected, "run `make types`"


def test_pages_call_procedures_as_the_catalogue_does() -> None:
    titles = json.loads((ROOT / "web/src/lib/procedure_titles.json").read_text(encoding="utf-8"))
    assert titles == {entry.name: entry.title for entry in CATALOGUE_INDEX}, "run `make types`"


def test_files_are_asked_for_with_a_label_too() -> None:
    entry = next(each for each in DEFINITIONS if each.name == "simulation_cell")
    for name in file_settings(entry.spec_type):
        assert label_of(entry.name, [name]) != name
