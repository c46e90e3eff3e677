"""Small drawings for certificates: figures against their limits, errors point by point, before and after.

Dots on linear axes that begin at zero: the length of a bar on a logarithmic axis means nothing. Shapes differ beside
colours, so that a copy in grey tells the same.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cellcal.calibration.message import make_message
from cellcal.service.certificates.blocks import PictureBlock
from cellcal.service.certificates.certificate_texts import ENGLISH
from cellcal.service.certificates.svg_drawing import (
    AFTER,
    BEFORE,
    GRID,
    LEFT,
    LIMIT,
    RIGHT,
    ROW,
    WIDTH,
    Axis,
    FigureScale,
    SvgDrawing,
    begin_chart,
    draw_grid,
    text_width,
)
from cellcal.service.quantities import format_quantity
from cellcal.service.translation import Translations

_LONGEST_NAME = 38  # letters beside a drawing
_MOST_POINTS = 400  # dots of one drawing: more are one blot
_MOST_LIMITS_SHOWN = 4.0  # beyond so many limits, a dot stands at the edge with its figure


def pictures_of(content: Mapping[str, Any], translations: Translations = ENGLISH) -> list[PictureBlock]:
    """Return every drawing that the content has figures for."""
    result = content["result"]
    found = [
        against_limits(content["verdict"]["characteristics"], translations),
        *before_and_after(content, translations),
    ]
    found += [errors_by_point(each, translations) for each in errors_in(result)]
    found += [scatter_of(content["points"], translations)]
    return [picture for picture in found if picture is not None]


def against_limits(
    characteristics: Sequence[Mapping[str, Any]], translations: Translations = ENGLISH
) -> PictureBlock | None:
    """Draw every judged figure with its U as a share of its limit, so that all fit on one axis."""
    judged = [figure for figure in characteristics if _has_share(figure)]
    if not judged:
        return None
    shares = [abs(figure["value"]) / figure["limit"] for figure in judged]
    spreads = [_uncertainty_bar(figure) / figure["limit"] for figure in judged]
    most = max(share + spread for share, spread in zip(shares, spreads, strict=True))
    axis = Axis(0.0, min(max(1.2, 1.05 * most), _MOST_LIMITS_SHOWN), LEFT, WIDTH - RIGHT)
    drawing = SvgDrawing(28.0 + ROW * len(judged) + 38.0)
    bottom = 28.0 + ROW * len(judged)
    draw_grid(drawing, axis, (18.0, bottom), FigureScale("%", 100.0, axis.high, translations.commas))
    x = axis.to_position(1.0)
    drawing.draw_line((x, 18.0), (x, bottom), LIMIT, 1.6, dashed=True)
    drawing.draw_text((x, 12.0), translations.translate("limit"), "middle", LIMIT)
    for row, (figure, share, spread) in enumerate(zip(judged, shares, spreads, strict=True)):
        y = 28.0 + ROW * (row + 0.5)
        drawing.draw_text(
            (LEFT - 10.0, y + 3.5), _shorten_name(translations.translate(figure["name"])), "end"
        )
        drawing.draw_line(
            (axis.to_position(share - spread), y), (axis.to_position(share + spread), y), AFTER, 2.0
        )
        drawing.draw_dot((axis.to_position(share), y), AFTER)
    drawing.draw_text(
        ((LEFT + WIDTH - RIGHT) / 2, bottom + 32.0),
        translations.translate("share of the limit [%]"),
        "middle",
    )
    description = "; ".join(
        f"{translations.translate(figure['name'])}: {translations.format_number(_format_percent(s))}"
        for figure, s in zip(judged, shares, strict=True)
    )
    caption = (
        "Judged figures as shares of their limits. "
        "The line through a dot is U; without one, the dot is U itself."
    )
    return drawing.to_picture(
        translations.translate(caption),
        f"{translations.translate('Dots on an axis from 0 to the limit.')} {description}.",
    )


def before_and_after(
    content: Mapping[str, Any], translations: Translations = ENGLISH
) -> Iterator[PictureBlock]:
    """Draw errors at poses that took no part in a fit; where there are none, what the run changed."""
    result = content["result"]
    identified = result.get("identified") if isinstance(result, dict) else None
    out = identified.get("hold_out") if isinstance(identified, dict) else None
    if isinstance(out, dict):
        rows = [
            _BeforeAfter(translations.translate(name), out[f"before_{key}"], out[f"after_{key}"])
            for name, key in (
                ("RMS error at check poses", "rms_m"),
                ("largest error at check poses", "max_m"),
            )
        ]
        caption = make_message(
            "Before and after at {out} check poses that took no part in the fit.", out=out["captures"]
        )
        yield _draw_pairs(rows, "m", translations.translate(caption), translations)
        return
    for unit, caption in (
        ("m", "What this run changed: lengths before and after."),
        ("rad", "What this run changed: angles before and after."),
    ):
        changes = [c for c in content["verdict"].get("changes", []) if c["unit"] == unit]
        comparable = [c for c in changes if c["before"] is not None and c["after"] is not None]
        if len(comparable) > 1:
            rows = [
                _BeforeAfter(translations.translate(c["name"]), c["before"], c["after"]) for c in comparable
            ]
            yield _draw_pairs(rows, unit, translations.translate(caption), translations)


@dataclass(frozen=True, slots=True)
class _BeforeAfter:
    """One figure before and after."""

    name: str
    before: float
    after: float


def _draw_pairs(
    rows: Sequence[_BeforeAfter], unit: str, caption: str, translations: Translations
) -> PictureBlock:
    """Draw two marks a row, joined, on an axis that has zero on it."""
    values = [value for row in rows for value in (row.before, row.after)]
    scale = FigureScale.for_largest(max(map(abs, values)), unit, commas=translations.commas)
    low, high = (scale.top if any(sign * v > 0 for v in values) else 0.0 for sign in (-1.0, 1.0))
    axis = Axis(-low, high or scale.top, LEFT, WIDTH - RIGHT)
    bottom = 28.0 + ROW * len(rows)
    drawing = SvgDrawing(bottom + 38.0)
    draw_grid(drawing, axis, (18.0, bottom), scale)
    for number, row in enumerate(rows):
        y = 28.0 + ROW * (number + 0.5)
        drawing.draw_text((LEFT - 10.0, y + 3.5), _shorten_name(row.name), "end")
        drawing.draw_line((axis.to_position(row.before), y), (axis.to_position(row.after), y), GRID, 2.0)
        drawing.draw_ring((axis.to_position(row.before), y), BEFORE)
        drawing.draw_dot((axis.to_position(row.after), y), AFTER)
    drawing.draw_key((LEFT, 12.0), translations.translate("before"), translations.translate("after"))
    drawing.draw_text(((LEFT + WIDTH - RIGHT) / 2, bottom + 32.0), f"[{scale.unit}]", "middle")
    description = "; ".join(
        f"{row.name}: "
        + translations.translate(
            make_message(
                "{value_before} before, {value_after} after",
                value_before=format_quantity(row.before, unit),
                value_after=format_quantity(row.after, unit),
            )
        )
        for row in rows
    )
    return drawing.to_picture(caption, f"{translations.translate('Two marks a row.')} {description}.")


@dataclass(frozen=True, slots=True)
class PointErrors:
    """Magnitudes of the errors of one list of points [m]."""

    what: str
    values_m: tuple[float, ...]
    names: tuple[str, ...] = ()


def errors_in(result: Any, where: str = "") -> Iterator[PointErrors]:
    """Find lists of errors in a result: residuals of points, and poses of an accuracy test."""
    if not isinstance(result, dict):
        return
    residuals, poses = result.get("residuals_m"), result.get("poses")
    if isinstance(residuals, list) and _are_points(residuals):
        names = tuple(map(str, result.get("tags") or ()))
        about = "" if where in ("", "found", "placed") else f"{where.replace('_', ' ')}: "
        yield PointErrors(f"{about}what each point misses by", tuple(map(_vector_length, residuals)), names)
    if isinstance(poses, list) and poses and all(isinstance(p, dict) and "ap_m" in p for p in poses):
        for key, word in (
            ("ap_m", "accuracy AP of each test pose"),
            ("rp_m", "repeatability RP of each test pose"),
        ):
            values = tuple(float(pose[key]) for pose in poses if pose.get(key) is not None)
            if values:
                yield PointErrors(f"{where.replace('_', ' ')} model: {word}".strip(), values)
    for key, value in result.items():
        yield from errors_in(value, key)


def errors_by_point(errors: PointErrors, translations: Translations = ENGLISH) -> PictureBlock | None:
    """Draw one dot a point."""
    if not 0 < len(errors.values_m) <= _MOST_POINTS:
        return None
    scale = FigureScale.for_largest(max(errors.values_m), commas=translations.commas)
    axis = Axis(0.0, scale.top, 120.0, 16.0)
    drawing, places = begin_chart(
        axis, scale, len(errors.values_m), translations.translate("point"), errors.names
    )
    for x, value in zip(places, errors.values_m, strict=True):
        drawing.draw_dot((x, axis.to_position(value)), AFTER)
    worst = max(range(len(errors.values_m)), key=errors.values_m.__getitem__)
    name = errors.names[worst] if worst < len(errors.names) else str(worst + 1)
    alt = make_message(
        "One dot a point, {values_m_count} points; the largest is {quantity} at {name}.",
        values_m_count=len(errors.values_m),
        quantity=format_quantity(errors.values_m[worst], "m"),
        name=name,
    )
    return drawing.to_picture(
        translations.translate(f"{errors.what[:1].upper()}{errors.what[1:]}."), translations.translate(alt)
    )


def scatter_of(
    points: Sequence[Mapping[str, Any]], translations: Translations = ENGLISH
) -> PictureBlock | None:
    """Draw what samples of one length differ from their mean, reading by reading."""
    taken = [(point["used"], samples) for point in points if len(samples := _sample_values(point)) > 1]
    spread = [[value - sum(samples) / len(samples) for value in samples] for _, samples in taken]
    most = max((abs(value) for each in spread for value in each), default=0.0)
    if not most > 1e-9 or sum(map(len, spread)) > _MOST_POINTS:
        return None
    scale = FigureScale.for_largest(most, commas=translations.commas)
    axis = Axis(-scale.top, scale.top, 120.0, 16.0)
    drawing, places = begin_chart(
        axis, scale, len(taken), translations.translate("length reading, in the order taken")
    )
    for x, (used, _), samples in zip(places, taken, spread, strict=True):
        for value in samples:
            (drawing.draw_dot if used else drawing.draw_ring)(
                (x, axis.to_position(value)), AFTER if used else LIMIT
            )
    drawing.draw_key((130.0, 12.0), translations.translate("not used"), translations.translate("used"), LIMIT)
    return drawing.to_picture(
        translations.translate("Samples of each reading: what they differ from their mean."),
        translations.translate(
            make_message(
                "{taken_count} readings; the largest difference is {quantity}.",
                taken_count=len(taken),
                quantity=format_quantity(most, "m"),
            )
        ),
    )


def _has_share(figure: Mapping[str, Any]) -> bool:
    """Return whether a limit is an upper one of a figure with an uncertainty; of others the side is unknown."""
    return bool(
        figure["decision"] and (figure["limit"] or 0.0) > 0.0 and figure["expanded_uncertainty"] > 0.0
    )


def _uncertainty_bar(figure: Mapping[str, Any]) -> float:
    expanded = float(figure["expanded_uncertainty"])
    return 0.0 if figure["value"] == expanded else expanded


def _format_percent(share: float) -> str:
    return f"{100.0 * share:.0f} %" if share >= 0.01 or share == 0.0 else f"{100.0 * share:.1g} %"


def _shorten_name(name: str) -> str:
    if text_width(name) <= _LONGEST_NAME:
        return name
    while text_width(name) >= _LONGEST_NAME:
        name = name[:-1]
    return f"{name.rstrip()}…"


def _are_points(value: list[Any]) -> bool:
    return bool(value) and all(
        isinstance(row, list) and len(row) == 3 and all(map(_is_number, row)) for row in value
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, float | int) and math.isfinite(value)


def _vector_length(point: Sequence[float]) -> float:
    return math.hypot(*point)


def _sample_values(point: Mapping[str, Any]) -> list[float]:
    value = point.get("value")
    samples = value.get("readings_m") if isinstance(value, dict) else None
    return [float(v) for v in samples] if isinstance(samples, list) and all(map(_is_number, samples)) else []
