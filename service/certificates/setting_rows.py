"""The settings of a run on its certificate: each under the label that pages show, its value in the reader's words."""

from collections.abc import Iterator, Mapping
from typing import Any

from cellcal.service.certificates.certificate_texts import ENGLISH, describe_pose, is_pose, short_facts
from cellcal.service.quantities import format_quantity
from cellcal.service.translation import Translations

_SCALED = ("m", "rad", "m/s", "rad/s")


def setting_rows(
    procedure: str, settings: Any, translations: Translations = ENGLISH
) -> Iterator[tuple[str, str]]:
    """Return label and value of the settings that fit on a line; an earlier version's have the name they had."""
    fields = _fields_of(procedure)
    for name, value in settings.items() if isinstance(settings, dict) else ():
        field = fields.get(name)
        if field is None:
            yield from short_facts({name: value}, translations)
        elif is_pose(value):
            yield translations.translate(field["title"]), describe_pose(value, translations)
        elif isinstance(value, bool | int | float | str) and value != "":
            yield translations.translate(field["title"]), _describe_value(field, value, translations)


def _describe_value(
    field: Mapping[str, Any], value: bool | int | float | str, translations: Translations
) -> str:
    if isinstance(value, bool):
        return translations.translate("yes" if value else "no")
    if isinstance(value, str):
        choices = field.get("x-choices", {})
        return translations.translate(choices[value]) if value in choices else value
    unit = field["x-unit"]
    if unit in _SCALED:
        return translations.format_number(format_quantity(value, unit))
    shown = translations.format_number(f"{value:.6g}" if isinstance(value, float) else str(value))
    return shown if unit in ("", "1", "count") else f"{shown} {unit}"


def _fields_of(procedure: str) -> Mapping[str, Any]:
    # Definitions are loaded when a page is printed, and not by each command that only names a certificate.
    from cellcal.procedures.catalogue import UnknownProcedureError  # noqa: PLC0415
    from cellcal.service.runs.settings_description import schema_of  # noqa: PLC0415

    try:
        fields: Mapping[str, Any] = schema_of(procedure, {})["properties"]
    except UnknownProcedureError:
        return {}
    return fields
