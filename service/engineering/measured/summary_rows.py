"""Rows under a table that sum it up, such as Mean and StdDev: numbers in every column, and no reading."""

import re
import unicodedata
from collections import Counter
from collections.abc import Callable, Mapping

import numpy as np

from cellcal.calibration.geometry import Array

_WORDS = frozenset({
    "mean", "average", "avg", "max", "maximum", "min", "minimum", "std", "stdev", "stddev", "std_dev",
    "st_dev", "standard_deviation", "deviation", "sigma", "variance", "var", "range", "sum", "total",
    "median", "rms", "rmse", "count", "mittel", "mittelwert", "durchschnitt", "standardabweichung",
    "stabw", "summe", "spannweite", "anzahl", "minimalwert", "maximalwert", "media", "promedio",
    "máximo", "mínimo", "desviación_estándar", "mediana", "suma", "rango", "moyenne", "écart_type",
    "médiane", "somme", "平均", "平均值", "最大", "最大值", "最小", "最小值",
    "标准差", "标准偏差", "总和", "极差", "中位数", "合计", "平均値", "最大値", "最小値", "標準偏差", "合計",
    "평균", "표준편차", "최대", "최소", "minimo", "massimo", "deviazione_standard", "scarto_tipo", "somma",
    "média", "desvio_padrão", "soma", "среднее", "среднее_значение", "ско", "стандартное_отклонение",
    "максимум", "минимум", "макс", "мин", "размах", "сумма", "średnia", "odchylenie_standardowe", "průměr",
    "gemiddelde", "standaarddeviatie", "medel", "ortalama",
})  # fmt: skip


def _without_accents(text: str) -> str:
    """Return ``ecart`` of ``écart``: headings are typed without accents as often as with them."""
    parts = unicodedata.normalize("NFKD", text)
    return unicodedata.normalize("NFC", "".join(c for c in parts if not unicodedata.combining(c)))


_STATISTICS: Mapping[str, Callable[[Array], Array]] = {
    "mean": lambda rows: np.mean(rows, axis=0),
    "standard deviation": lambda rows: np.std(rows, axis=0, ddof=1),
    "standard deviation of all": lambda rows: np.std(rows, axis=0),
    "minimum": lambda rows: np.min(rows, axis=0),
    "maximum": lambda rows: np.max(rows, axis=0),
    "range": lambda rows: np.ptp(rows, axis=0),
    "median": lambda rows: np.median(rows, axis=0),
    "sum": lambda rows: np.sum(rows, axis=0),
}
_FEWEST_ROWS, _MOST_SUMMARIES = 8, 6
_FEWEST_COLUMNS = 4
_LARGEST = 1e12  # beyond, and what is no number, is no reading
_EQUAL = 1e-3  # of a column's deviation: summaries are rounded
_FEWEST_SUMMARIES, _FEWEST_VARYING = 2, 2
_ROUNDED = 0.05  # of the range of a few rows: their summaries are rounded
_MOST_SHARE = 0.2  # of the rows: where more have such a name, it is a name


def summary_rows(texts: Mapping[tuple[int, int], str], count: int) -> dict[int, str]:
    """Return the rows of a table that are summaries of the others, and the word that says so.

    A word that stands in several rows of its column, such as a speed ``max``, names what was measured.
    """
    often = Counter((column, _plain(text)) for (_, column), text in texts.items())
    found = {
        row: text
        for (row, column), text in sorted(texts.items())
        if _plain(text) in _PLAIN_WORDS and often[column, _plain(text)] == 1
    }
    return found if len(found) <= _MOST_SHARE * count else {}


def block_summaries(texts: Mapping[tuple[int, int], str], numbers: Array) -> dict[int, str]:
    """Return rows that sum up the few rows above each of them, such as ``P1 average`` behind P1.1 to P1.3.

    A word of a summary ends a cell of theirs, and most of them are, in every column, a statistic of the rows since
    the summaries before.
    """
    row_texts = {
        row: text
        for (row, _), text in sorted(texts.items())
        if _plain(text).rpartition("_")[2] in _PLAIN_WORDS
    }
    matches, first, above = 0, 0, numbers[:0]
    for row in row_texts:
        if row - 1 not in row_texts:
            above = numbers[first:row]
        first = row + 1
        matches += len(above) > 1 and _is_statistic(numbers[row], above)
    return row_texts if matches >= _FEWEST_SUMMARIES and 2 * matches > len(row_texts) else {}


def _is_statistic(row: Array, above: Array) -> bool:
    varying = np.isfinite(above).all(axis=0) & (np.ptp(above, axis=0) > 0.0) & np.isfinite(row)
    if varying.sum() < _FEWEST_VARYING:
        return False
    some, tolerance = above[:, varying], _ROUNDED * np.ptp(above[:, varying], axis=0)
    return any((np.abs(of(some) - row[varying]) <= tolerance).all() for of in _STATISTICS.values())


def calculated_rows(numbers: Array) -> dict[int, str]:
    """Return the last rows of a table (N, k) that are a statistic of the rows above in every column, and which.

    No posture has the mean, or the largest number, of every column; no word beside them is needed.
    """
    for count in range(_MOST_SUMMARIES, 0, -1):
        above, last = numbers[:-count], numbers[-count:]
        if len(above) < _FEWEST_ROWS:
            continue
        columns = (np.abs(above) < _LARGEST).all(axis=0)
        spread = np.where(columns, np.std(np.where(columns, above, 0.0), axis=0), 0.0)
        varying = spread > 0.0
        statistics = {name: of(above[:, varying]) for name, of in _STATISTICS.items()}
        found = [_statistic_of(row[varying], statistics, spread[varying]) for row in last]
        if all(found):
            return {len(above) + at: name for at, name in enumerate(found)}
    return {}


def _statistic_of(row: Array, statistics: Mapping[str, Array], spread: Array) -> str:
    filled = np.isfinite(row)
    if filled.sum() < max(_FEWEST_COLUMNS, 0.5 * len(row)):
        return ""
    tolerance = _EQUAL * spread[filled]
    return next(
        (name for name, value in statistics.items() if (np.abs(row - value)[filled] <= tolerance).all()), ""
    )


def _plain(text: str) -> str:
    return _without_accents(re.sub(r"[\s.\-:_]+", "_", text.strip().lower()).strip("_"))


_PLAIN_WORDS = frozenset(_without_accents(word) for word in _WORDS)
