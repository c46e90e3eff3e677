"""Prometheus' text format 0.0.4, written as its document says.

Source: prometheus.io/docs/instrumenting/exposition_formats, "Text format details".
"""

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
_NAME = re.compile(r"[a-zA-Z_:][a-zA-Z0-9_:]*")
_LABEL = re.compile(r"[a-zA-Z_][a-zA-Z0-9_]*")
_ESCAPES = str.maketrans({"\\": "\\\\", "\n": "\\n", '"': '\\"'})
_HELP_ESCAPES = str.maketrans({"\\": "\\\\", "\n": "\\n"})


@dataclass
class MetricFamily:
    """Samples of one name. ``kind``: gauge or counter."""

    name: str
    kind: str
    help: str
    samples: dict[tuple[tuple[str, str], ...], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if _NAME.fullmatch(self.name) is None or (self.kind == "counter") != self.name.endswith("_total"):
            raise ValueError(f"{self.name} is no name of a {self.kind}")

    def add_sample(self, value: float | None, labels: Mapping[str, str] | None = None) -> "MetricFamily":
        """Add a sample; one without a value, or that is there already, is left out."""
        key = tuple(sorted((labels or {}).items()))
        if any(_LABEL.fullmatch(name) is None for name, _ in key):
            raise ValueError(f"{self.name} has a label that is no name")
        if value is not None:
            self.samples.setdefault(key, float(value))
        return self


def render_text(families: Iterable[MetricFamily]) -> str:
    """Return the text; a family without samples is left out."""
    lines: list[str] = []
    for family in families:
        if not family.samples:
            continue
        lines.append(f"# HELP {family.name} {family.help.translate(_HELP_ESCAPES)}")
        lines.append(f"# TYPE {family.name} {family.kind}")
        lines += [
            f"{family.name}{_render_labels(key)} {_render_number(value)}"
            for key, value in family.samples.items()
        ]
    return "".join(f"{line}\n" for line in lines)


def _render_labels(labels: tuple[tuple[str, str], ...]) -> str:
    if not labels:
        return ""
    return "{" + ",".join(f'{name}="{value.translate(_ESCAPES)}"' for name, value in labels) + "}"


def _render_number(value: float) -> str:
    if math.isfinite(value):
        return repr(value)
    return "NaN" if math.isnan(value) else "+Inf" if value > 0 else "-Inf"
