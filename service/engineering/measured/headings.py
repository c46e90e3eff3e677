"""Headings of many languages in one spelling: what the words of a column's name mean, and which unit it tells."""

import re
from collections.abc import Sequence

from cellcal.calibration.message import make_message

_UNIT = re.compile(r"[\[(\uff08\u3010]\s*(?P<unit>[^\])\uff09\u3011]*)\s*[\])\uff09\u3011]")
_TRAILING_UNIT = re.compile(
    r"_(mm|deg|rad|m|degrees|radians|cm|um|inches|inch|in|ft|feet|mils|mil|grad|gon|mrad|mdeg|rev|revs)$"
)
_UNIT_NAMES = {
    "mm": "mm", "m": "m", "cm": "cm", "deg": "deg", "°": "deg", "º": "deg", "degree": "deg", "degrees": "deg",
    "rad": "rad", "radian": "rad", "radians": "rad", "millimeter": "mm", "millimeters": "mm", "mms": "mm",
    "meter": "m", "meters": "m", "metres": "m", "millimetre": "mm", "millimetres": "mm", "metre": "m",
    "centimeter": "cm", "centimeters": "cm", "centimetre": "cm", "zentimeter": "cm", "centímetros": "cm",
    "grad": "deg", "in": "inch", "inch": "inch", "inches": "inch", '"': "inch", "''": "inch", "\u2033": "inch",
    "”": "inch", "zoll": "inch", "pulgadas": "inch", "pulgada": "inch", "µm": "um", "um": "um", "μm": "um",
    "micron": "um", "microns": "um", "mil": "mil", "mils": "mil", "thou": "mil", "ft": "ft", "foot": "ft",
    "feet": "ft", "'": "ft", "\u2032": "ft", "mrad": "mrad", "mdeg": "mdeg", "gon": "gon", "grados": "deg",
    "grado": "deg", "radianes": "rad", "bogenmaß": "rad", "milímetros": "mm", "metros": "m",
    "毫米": "mm", "米": "m", "厘米": "cm", "公厘": "mm", "公分": "cm", "度": "deg", "角度": "deg", "弧度": "rad",
    "英寸": "inch", "英吋": "inch", "英尺": "ft", "微米": "um", "ミリ": "mm", "ミリメートル": "mm", "ラジアン": "rad",
    "インチ": "inch", "град": "deg", "градус": "deg", "градусы": "deg", "рад": "rad", "мм": "mm", "см": "cm",
    "м": "m", "мкм": "um", "дюйм": "inch", "millimetri": "mm", "gradi": "deg", "radianti": "rad", "graus": "deg",
    "degrés": "deg", "degré": "deg", "stopnie": "deg", "graden": "deg", "grader": "deg", "derece": "deg",
    "astetta": "deg", "fok": "deg", "rev": "rev", "revs": "rev", "revolution": "rev", "revolutions": "rev",
    "turn": "rev", "turns": "rev", "umdrehung": "rev", "umdrehungen": "rev", "vueltas": "rev",
    "圈": "rev", "转": "rev", "arcmin": "arcmin", "arcminute": "arcmin", "arcminutes": "arcmin",
    "winkelminuten": "arcmin", "arcsec": "arcsec", "arcsecond": "arcsec", "arcseconds": "arcsec",
    "winkelsekunden": "arcsec", "角分": "arcmin", "角秒": "arcsec", "millideg": "mdeg",
}  # fmt: skip
# What a word of a heading means, in the words that columns are told by; the longer first where one holds another.
_WORDS: Sequence[tuple[str, str]] = (
    ("关节角度", "joint"), ("关节角", "joint"), ("关节", "joint"), ("關節", "joint"), ("関節角度", "joint"),
    ("関節角", "joint"), ("関節", "joint"), ("机器人", "robot"), ("機器人", "robot"), ("ロボット", "robot"),
    ("测量值", "measured"), ("实测值", "measured"), ("实测", "measured"), ("實測", "measured"), ("实际", "actual"),
    ("實際", "actual"), ("测量", "measured"), ("測量", "measured"), ("実測値", "measured"), ("実測", "measured"),
    ("測定値", "measured"), ("測定", "measured"), ("计测", "measured"), ("計測", "measured"), ("跟踪仪", "tracker"),
    ("激光", "laser"), ("理论值", "nominal"), ("理论", "nominal"), ("理論値", "nominal"), ("理論", "nominal"),
    ("名义", "nominal"), ("标称", "nominal"), ("公称", "nominal"), ("设计值", "nominal"), ("设计", "nominal"),
    ("設計", "nominal"), ("指令", "command"), ("目标", "target"), ("目標", "target"),
    ("设定", "setpoint"),
    ("示教", "programmed"), ("偏差", "deviation"), ("误差", "error"), ("誤差", "error"),
    ("差值", "deviation"),
    ("不确定度", "uncertainty"), ("标准差", "std"), ("標準偏差", "std"), ("位置坐标", ""), ("坐标值", ""),
    ("坐标", ""),
    ("座標", ""), ("位置", ""), ("温度", "temperature"), ("溫度", "temperature"), ("长度", "length"),
    ("長度", "length"),
    ("長さ", "length"), ("拉线", "wire"), ("绳长", "wire_length"), ("距离", "distance"), ("距離", "distance"),
    ("点名称", "point_name"), ("点名", "point_name"), ("点号", "point_name"), ("點名", "point_name"),
    ("名称", "name"), ("名稱", "name"), ("名前", "name"), ("测点", "point"), ("测站", "station"),
    ("序号", "index"), ("编号", "index"), ("組", "group"), ("组", "group"), ("时间", "time"), ("時間", "time"),
    ("관절", "joint"), ("측정", "measured"), ("실측", "measured"), ("이론", "nominal"), ("공칭", "nominal"),
    ("편차", "deviation"), ("좌표", ""), ("온도", "temperature"), ("축", "axis"),
    ("轴", "axis"), ("軸", "axis"), ("角度", "angle"), ("第", ""), ("值", ""), ("値", ""),
    ("gemessene", "measured"), ("gemessener", "measured"), ("gemessen", "measured"), ("messwert", "measured"),
    ("messung", "measured"), ("istwert", "measured"), ("ist", "actual"), ("sollwert", "nominal"), ("soll", "nominal"),
    ("abweichung", "deviation"), ("differenz", "deviation"), ("messunsicherheit", "uncertainty"),
    ("unsicherheit", "uncertainty"), ("temperatur", "temperature"), ("seillänge", "wire_length"),
    ("länge", "length"), ("abstand", "distance"), ("gelenkwinkel", "joint"), ("gelenk", "joint"), ("achse", "axis"),
    ("achswinkel", "axis"), ("punkt", "point"), ("punktname", "point_name"), ("gruppe", "group"),
    ("medida", "measured"), ("medido", "measured"), ("medición", "measured"), ("medidas", "measured"),
    ("real", "actual"), ("teórica", "nominal"), ("teórico", "nominal"), ("desviación", "deviation"),
    ("incertidumbre", "uncertainty"), ("temperatura", "temperature"), ("articulación", "joint"),
    ("articulacion", "joint"), ("eje", "axis"), ("longitud", "length"), ("distancia", "distance"),
    ("punto", "point"), ("grupo", "group"), ("mesuré", "measured"), ("mesurée", "measured"), ("écart", "deviation"),
    ("théorique", "nominal"), ("axe", "axis"), ("longueur", "length"), ("articulation", "joint"),
    ("mesure", "measured"), ("réel", "actual"), ("réelle", "actual"),
    ("giunto", "joint"), ("asse", "axis"), ("misurato", "measured"), ("misurata", "measured"), ("misura", "measured"),
    ("nominale", "nominal"), ("teorico", "nominal"), ("teorica", "nominal"), ("scostamento", "deviation"),
    ("effettivo", "actual"), ("effettiva", "actual"), ("junta", "joint"), ("eixo", "axis"), ("desvio", "deviation"),
    ("ось", "axis"), ("оси", "axis"), ("сустав", "joint"), ("шарнир", "joint"), ("точка", "point"),
    ("измеренный", "measured"), ("измеренная", "measured"), ("измеренное", "measured"), ("измеренные", "measured"),
    ("измерено", "measured"),
    ("измерение", "measured"), ("изм", "measured"), ("фактическое", "actual"), ("факт", "actual"),
    ("заданный", "nominal"), ("заданная", "nominal"), ("заданное", "nominal"), ("заданные", "nominal"),
    ("задано", "nominal"),
    ("номинал", "nominal"), ("номинальное", "nominal"), ("отклонение", "deviation"), ("погрешность", "error"),
    ("температура", "temperature"), ("длина", "length"), ("координата", ""), ("угол", "angle"), ("группа", "group"),
    ("oś", "axis"), ("przegub", "joint"), ("zmierzony", "measured"), ("zmierzona", "measured"), ("osa", "axis"),
    ("kloub", "joint"), ("změřeno", "measured"), ("měřeno", "measured"), ("eksen", "axis"), ("eklem", "joint"),
    ("ölçülen", "measured"), ("gewricht", "joint"), ("gemeten", "measured"), ("as", "axis"), ("axel", "axis"),
    ("uppmätt", "measured"), ("mätt", "measured"), ("akse", "axis"), ("målt", "measured"),
    ("akseli", "axis"), ("mitattu", "measured"), ("tengely", "axis"), ("mért", "measured"),
    ("zmierzone", "measured"), ("axa", "axis"), ("măsurat", "measured"),
)  # fmt: skip


def _is_cjk(text: str) -> bool:
    return any("\u3040" <= character <= "\u9fff" or "\uac00" <= character <= "\ud7a3" for character in text)


_INSIDE = [(word, meaning) for word, meaning in _WORDS if _is_cjk(word)]
_WHOLE = {word: meaning for word, meaning in _WORDS if not _is_cjk(word)}
_COMMA_UNIT = re.compile(r",\s*(?P<unit>[^\s,]+)\s*$")  # J1, deg
_COUNTED_UNIT = re.compile(  # 0.001 mm
    r"(?:0[.,](?P<zeros>0*)1|1e-0?(?P<power>[1-9])|1/1(?P<noughts>0+)|10\^-(?P<exponent>[1-9]))\s*[*x·]?\s*(?P<unit>\S+)"
)
_PARTS = {
    (1, "cm"): "mm", (2, "m"): "cm", (3, "m"): "mm", (4, "m"): "0.1mm", (5, "m"): "0.01mm", (6, "m"): "um",
    (1, "mm"): "0.1mm", (2, "mm"): "0.01mm", (3, "mm"): "um", (3, "inch"): "mil",
    (1, "deg"): "0.1deg", (2, "deg"): "0.01deg", (3, "deg"): "mdeg", (4, "deg"): "0.0001deg",
    (6, "deg"): "0.000001deg", (3, "rad"): "mrad",
}  # fmt: skip
_CJK_NUMBERS = "一二三四五六七八九"
_CJK_NUMBER = re.compile(rf"[{_CJK_NUMBERS}](?=\s*(?:轴|軸|关节|關節|関節))|(?<=[轴軸节節])[{_CJK_NUMBERS}]")
_WORD_AND_NUMBER = re.compile(r"([^\W\d_]+)(\d+)")
_CASE_BOUNDARY = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")  # MeasX, XNominal
_PULSES = re.compile(
    r"(?<![^\W_])(pulses?|puls|impulse|impulsos|counts?|cnts?|increments?|inkremente|incr|ticks)(?![^\W_])|脉冲|パルス",
    re.IGNORECASE,
)
PULSES_REMEDY = (
    "If it holds encoder pulses, divide each joint's by its pulses per degree, with their sign, from the "
    "controller's parameters. If it holds parts of degrees, say which: `--units joints=mdeg` for thousandths, "
    "`--units joints=0.0001deg` for ten thousandths."
)
_NUMBER_FIRST = re.compile(r"(?<![a-z\d])(\d)_?(axis|joint)(?![a-z])(?!_?\d)")


def pulses_remedy(columns: Sequence[str], count: int) -> str:
    """Return what helps where columns are called pulses, given by their numbers: a unit goes with named columns."""
    if len(columns) != count:
        return PULSES_REMEDY
    return make_message(
        "{remedy} Name the columns with it: `--columns joints={columns}`.",
        remedy=PULSES_REMEDY,
        columns=",".join(columns),
    )


def plain_name(name: str) -> str:
    """Return a name in one spelling: lower case, words joined by underscores, without its unit, in English."""
    text = _CASE_BOUNDARY.sub("_", _UNIT.sub(_inside_brackets, _without_comma_unit(name)).strip()).lower()
    text = _CJK_NUMBER.sub(lambda found: str(_CJK_NUMBERS.index(found[0]) + 1), text)
    for word, meaning in _INSIDE:
        text = text.replace(word, f"_{meaning}_")
    text = re.sub(r"[\s.\-/:'+#\uff0c、\uff1a]+", "_", text)
    text = re.sub(r"_{2,}", "_", text).strip("_")
    text = "_".join(_meaning_of(word) for word in text.split("_"))
    text = _NUMBER_FIRST.sub(r"\2_\1", text)
    return _TRAILING_UNIT.sub("", text)


def _meaning_of(word: str) -> str:
    """Return what a word means, with the number that is glued to it: "giunto1" is "joint1"."""
    numbered = _WORD_AND_NUMBER.fullmatch(word)
    if word in _WHOLE or numbered is None or numbered[1] not in _WHOLE:
        return _WHOLE.get(word, word)
    return f"{_WHOLE[numbered[1]]}{numbered[2]}"


def _without_comma_unit(name: str) -> str:
    comma = _COMMA_UNIT.search(name)
    return name[: comma.start()] if comma and unit_named(comma["unit"]) else name


def without_unit(name: str) -> str:
    """Return a name as it is written, without a unit in brackets."""
    return _UNIT.sub("", name).strip()


def _inside_brackets(found: re.Match[str]) -> str:
    """Keep what stands in brackets and is no unit as a word of the name: ``U(95)``, ``X (Base)``."""
    text = found["unit"].strip()
    plain = bool(re.fullmatch(r"\d+", text))
    return f"_{text}_" if plain else ""


def unit_of(name: str) -> str:
    """Return the unit that a name tells, empty if none that is known."""
    for bracket in reversed(list(_UNIT.finditer(name))):
        unit = unit_named(bracket["unit"])
        if unit:
            return unit
    comma = _COMMA_UNIT.search(name)
    if comma and (unit := unit_named(comma["unit"])):
        return unit
    trailing = _TRAILING_UNIT.search(re.sub(r"[\s.\-]+", "_", name.strip().lower()))
    return unit_named(trailing[1]) if trailing else ""


def unit_named(text: str) -> str:
    """Return the one spelling of a unit, empty for what is none."""
    if counted := _COUNTED_UNIT.fullmatch(text.strip().lower()):
        written = counted["power"] or counted["exponent"]
        places = int(written) if written else len(counted["noughts"] or f"{counted['zeros']}1")
        return _PARTS.get((places, unit_named(counted["unit"])), "")
    return _UNIT_NAMES.get(text.strip().rstrip(".").lower(), "") or _UNIT_NAMES.get(text.strip().lower(), "")


def counts_pulses(name: str) -> bool:
    """Return whether a name tells numbers of an encoder in place of an angle."""
    return _PULSES.search(name) is not None and not unit_of(name)


def heading_words() -> tuple[str, ...]:
    """Return words of headings in writing that needs to be decoded: where they appear, the encoding is right."""
    return (*(word for word, _ in _INSIDE if len(word) > 1), "轴", "軸", "毫米", "英寸", "弧度")
