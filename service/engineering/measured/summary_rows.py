"""Rows under a table that sum it up, such as Mean and StdDev: numbers in every column, and no reading."""

import re
from collections import Counter
from collections.abc import Mapping

_WORDS = frozenset({
    "mean", "average", "avg", "max", "maximum", "min", "minimum", "std", "stdev", "stddev", "std_dev",
    "st_dev", "standard_deviation", "deviation", "sigma", "variance", "var", "range", "sum", "total",
    "median", "rms", "rmse", "count", "mittel", "mittelwert", "durchschnitt", "standardabweichung",
    "stabw", "summe", "spannweite", "anzahl", "minimalwert", "maximalwert", "media", "promedio",
    "máximo", "mínimo", "desviación_estándar", "mediana", "suma", "rango", "moyenne", "écart_type",
    "médiane", "somme", "平均", "平均值", "最大", "最大值", "最小", "最小值",
    "标准差", "标准偏差", "总和", "极差", "中位数", "合计",
})  # fmt: skip
_MOST_SHARE = 0.2  # of the rows: where more have such a name, it is a name


def summary_rows(texts: Mapping[tuple[int, int], str], count: int) -> dict[int, str]:
    """Return the rows of a table that are summaries of the others, and the word that says so.

    A word that stands in several rows of its column, such as a speed ``max``, names what was measured.
    """
    often = Counter((column, _plain(text)) for (_, column), text in texts.items())
    found = {
        row: text
        for (row, column), text in sorted(texts.items())
        if _plain(text) in _WORDS and often[column, _plain(text)] == 1
    }
    return found if len(found) <= _MOST_SHARE * count else {}


def _plain(text: str) -> str:
    return re.sub(r"[\s.\-:_]+", "_", text.strip().lower()).strip("_")
