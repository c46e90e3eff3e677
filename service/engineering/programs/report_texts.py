# ruff: noqa: RUF001  Chinese has its own commas and brackets
"""The words of a report's page in every language; reasons and warnings come from the tables of refusals."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from cellcal.service.translation import Locale, Translations, load_translations

Forms = tuple[str, str]  # for one, for more


@dataclass(frozen=True, slots=True)
class ReportTexts:
    """One language; a sentence that a language lacks is found by the type checker."""

    counts: str
    programs: Forms
    points: Forms
    left_means: str
    points_off: Forms
    files_refused: Forms
    programs_unread: Forms
    expected_most: str
    without_most: str
    refused_title: str
    notes_title: str
    picture_title: str
    programs_title: str
    points_title: str
    no_picture: str
    in_base: str
    in_frames: str
    moved_title: str
    expected_title: str
    some_drawn: str
    not_drawn: Forms
    under_mouse: str
    label_left: str
    label_moved: str
    program_heads: tuple[str, str, str, str, str, str, str, str]  # "#": of a column of numbers
    point_heads: tuple[str, str, str, str, str, str, str, str]
    worst_first: str
    worst_programs: str
    worst_points: str
    from_above: str
    from_the_side: str
    axis: str
    axis_of: str
    step: str
    not_known: str
    excluded_label: str
    lines: Forms
    more_lines: str
    more_programs: Forms


ENGLISH = ReportTexts(
    counts="{programs}, {points}: {changed} changed, {unchanged} unchanged, {left} left as they were.",
    programs=("{} program", "{} programs"),
    points=("{} point", "{} points"),
    left_means="Nothing of a point that is left was changed: see its reason, and teach it or change its program.",
    points_off=(
        "{} more point that a motion goes to misses its place: the notes say why.",
        "{} more points that motions go to miss their places: the notes say why.",
    ),
    files_refused=("{} file refused.", "{} files refused."),
    programs_unread=(
        "{} program is not read, and its points stay: {{}}.",
        "{} programs are not read, and their points stay: {{}}.",
    ),
    expected_most="Expected error at most {} mm (k = 2).",
    without_most="Without the robots' models points would miss by up to {} mm.",
    refused_title="Files that were refused; no new one was written for them",
    notes_title="What to know before these programs run",
    picture_title="Where the points are",
    programs_title="Programs",
    points_title="Points",
    no_picture="No picture: the location of these points is unknown.",
    in_base="in the robot's base",
    in_frames="in each point's own user frame",
    moved_title="How far each point moved",
    expected_title="Expected error of each point in its cell, k = 2",
    some_drawn="{shown} of {total} points are drawn.",
    not_drawn=("{} point is not drawn: its place is unknown.", "{} points are not drawn: their place is unknown."),
    under_mouse="A point's name is under the mouse.",
    label_left="{point}: left as it was. {reason}",
    label_moved="{point}: moved {shift} mm, expected error {expected} mm",
    program_heads=(
        "program", "file", "points#", "changed#", "unchanged#", "left#", "largest shift, mm#",
        "largest expected error, mm#",
    ),
    point_heads=(
        "program", "point", "line#", "shift, mm#", "turn, deg#", "expected error, mm#", "without models, mm#",
        "left as it was, because",
    ),
    worst_first="Worst first.",
    worst_programs="The worst {shown} of {total} programs, worst first; the CSV and JSON files hold all.",
    worst_points="The worst {shown} of {total} points, worst first; the CSV and JSON files hold all.",
    from_above="from above",
    from_the_side="from the side",
    axis="{} in mm",
    axis_of="{axis} in mm, {about}",
    step="{} to {}",
    not_known="not known",
    excluded_label="left as it was",
    lines=("line {}", "lines {}"),
    more_lines="{} and {} more",
    more_programs=("{} and {} more program", "{} and {} more programs"),
)  # fmt: skip
GERMAN = ReportTexts(
    counts="{programs}, {points}: {changed} geändert, {unchanged} unverändert, {left} belassen.",
    programs=("{} Programm", "{} Programme"),
    points=("{} Punkt", "{} Punkte"),
    left_means="Ein belassener Punkt ist unverändert: Siehe Grund; teachen Sie ihn, oder ändern Sie das Programm.",
    points_off=(
        "{} weiterer Punkt, zu dem eine Bewegung geht, verfehlt seinen Ort: Die Hinweise sagen, warum.",
        "{} weitere Punkte, zu denen Bewegungen gehen, verfehlen ihren Ort: Die Hinweise sagen, warum.",
    ),
    files_refused=("{} Datei abgelehnt.", "{} Dateien abgelehnt."),
    programs_unread=(
        "{} Programm wird nicht gelesen, und seine Punkte bleiben: {{}}.",
        "{} Programme werden nicht gelesen, und ihre Punkte bleiben: {{}}.",
    ),
    expected_most="Zu erwartende Abweichung höchstens {} mm (k = 2).",
    without_most="Ohne die Modelle der Roboter lägen Punkte bis zu {} mm daneben.",
    refused_title="Abgelehnte Dateien; für sie wurde keine neue geschrieben",
    notes_title="Was vor dem Lauf dieser Programme zu wissen ist",
    picture_title="Wo die Punkte liegen",
    programs_title="Programme",
    points_title="Punkte",
    no_picture="Kein Bild: Niemand weiß, wo diese Punkte liegen.",
    in_base="in der Basis des Roboters",
    in_frames="im eigenen Benutzerkoordinatensystem jedes Punkts",
    moved_title="Wie weit jeder Punkt verschoben wurde",
    expected_title="Zu erwartende Abweichung jedes Punkts in seiner Zelle, k = 2",
    some_drawn="{shown} von {total} Punkten sind gezeichnet.",
    not_drawn=(
        "{} Punkt ist nicht gezeichnet: Seine Lage ist unbekannt.",
        "{} Punkte sind nicht gezeichnet: Ihre Lage ist unbekannt.",
    ),
    under_mouse="Unter dem Mauszeiger steht der Name eines Punkts.",
    label_left="{point}: belassen. {reason}",
    label_moved="{point}: um {shift} mm verschoben, zu erwartende Abweichung {expected} mm",
    program_heads=(
        "Programm", "Datei", "Punkte#", "geändert#", "unverändert#", "belassen#", "größte Verschiebung, mm#",
        "größte zu erwartende Abweichung, mm#",
    ),
    point_heads=(
        "Programm", "Punkt", "Zeile#", "Verschiebung, mm#", "Drehung, Grad#", "zu erwartende Abweichung, mm#",
        "ohne Modelle, mm#", "belassen, weil",
    ),
    worst_first="Die schlechtesten zuerst.",
    worst_programs="Die schlechtesten {shown} von {total} Programmen zuerst; CSV- und JSON-Datei enthalten alle.",
    worst_points="Die schlechtesten {shown} von {total} Punkten zuerst; CSV- und JSON-Datei enthalten alle.",
    from_above="von oben",
    from_the_side="von der Seite",
    axis="{} in mm",
    axis_of="{axis} in mm, {about}",
    step="{} bis {}",
    not_known="nicht bekannt",
    excluded_label="belassen",
    lines=("Zeile {}", "Zeilen {}"),
    more_lines="{} und {} weitere",
    more_programs=("{} und {} weiteres Programm", "{} und {} weitere Programme"),
)  # fmt: skip
SPANISH = ReportTexts(
    counts="{programs}, {points}: {changed} cambiados, {unchanged} sin cambios, {left} dejados como estaban.",
    programs=("{} programa", "{} programas"),
    points=("{} punto", "{} puntos"),
    left_means="En un punto que se dejó no se cambió nada: lea el motivo y enséñelo o cambie su programa.",
    points_off=(
        "{} punto más al que va un movimiento no está en su lugar: las notas dicen por qué.",
        "{} puntos más a los que van movimientos no están en su lugar: las notas dicen por qué.",
    ),
    files_refused=("{} archivo rechazado.", "{} archivos rechazados."),
    programs_unread=(
        "{} programa no se lee y sus puntos quedan igual: {{}}.",
        "{} programas no se leen y sus puntos quedan igual: {{}}.",
    ),
    expected_most="Error esperado de {} mm como máximo (k = 2).",
    without_most="Sin los modelos de los robots los puntos fallarían hasta en {} mm.",
    refused_title="Archivos rechazados; no se escribió ninguno nuevo para ellos",
    notes_title="Lo que hay que saber antes de ejecutar estos programas",
    picture_title="Dónde están los puntos",
    programs_title="Programas",
    points_title="Puntos",
    no_picture="Sin imagen: nadie sabe dónde están estos puntos.",
    in_base="en la base del robot",
    in_frames="en el sistema de usuario de cada punto",
    moved_title="Cuánto se desplazó cada punto",
    expected_title="Error esperado de cada punto en su célula, k = 2",
    some_drawn="Se dibujan {shown} de {total} puntos.",
    not_drawn=(
        "{} punto no se dibuja: se desconoce su lugar.",
        "{} puntos no se dibujan: se desconoce su lugar.",
    ),
    under_mouse="El nombre de un punto aparece bajo el ratón.",
    label_left="{point}: se dejó como estaba. {reason}",
    label_moved="{point}: desplazado {shift} mm, error esperado {expected} mm",
    program_heads=(
        "programa", "archivo", "puntos#", "cambiados#", "sin cambios#", "dejados#", "mayor desplazamiento, mm#",
        "mayor error esperado, mm#",
    ),
    point_heads=(
        "programa", "punto", "línea#", "desplazamiento, mm#", "giro, grados#", "error esperado, mm#",
        "sin modelos, mm#", "se dejó como estaba porque",
    ),
    worst_first="Los peores primero.",
    worst_programs="Los {shown} peores de {total} programas primero; los archivos CSV y JSON los contienen todos.",
    worst_points="Los {shown} peores de {total} puntos primero; los archivos CSV y JSON los contienen todos.",
    from_above="desde arriba",
    from_the_side="de lado",
    axis="{} en mm",
    axis_of="{axis} en mm, {about}",
    step="{} a {}",
    not_known="desconocido",
    excluded_label="se dejó como estaba",
    lines=("línea {}", "líneas {}"),
    more_lines="{} y {} más",
    more_programs=("{} y {} programa más", "{} y {} programas más"),
)  # fmt: skip
CHINESE = ReportTexts(
    counts="{programs}，{points}：{changed} 个已更改，{unchanged} 个未变，{left} 个保持原样。",
    programs=("{} 个程序", "{} 个程序"),
    points=("{} 个点", "{} 个点"),
    left_means="保持原样的点未作任何更改：请查看原因，并重新示教该点或修改其程序。",
    points_off=("另有 {} 个运动目标点未到达其位置：原因见说明。", "另有 {} 个运动目标点未到达其位置：原因见说明。"),
    files_refused=("拒绝了 {} 个文件。", "拒绝了 {} 个文件。"),
    programs_unread=("{} 个程序无法读取，其点保持原样：{{}}。", "{} 个程序无法读取，其点保持原样：{{}}。"),
    expected_most="预期误差最大 {} mm（k = 2）。",
    without_most="若不用机器人的模型，点的偏差可达 {} mm。",
    refused_title="被拒绝的文件；没有为它们写出新文件",
    notes_title="运行这些程序之前须知",
    picture_title="各点的位置",
    programs_title="程序",
    points_title="点",
    no_picture="没有图：无人知道这些点在哪里。",
    in_base="机器人基坐标系",
    in_frames="各点自己的用户坐标系",
    moved_title="各点的移动量",
    expected_title="各点在其单元中的预期误差，k = 2",
    some_drawn="画出 {total} 个点中的 {shown} 个。",
    not_drawn=("{} 个点未画出：位置未知。", "{} 个点未画出：位置未知。"),
    under_mouse="鼠标指向点时显示其名称。",
    label_left="{point}：保持原样。{reason}",
    label_moved="{point}：移动 {shift} mm，预期误差 {expected} mm",
    program_heads=("程序", "文件", "点数#", "已更改#", "未变#", "保持原样#", "最大移动量，mm#", "最大预期误差，mm#"),
    point_heads=(
        "程序", "点", "行#", "移动量，mm#", "转动，度#", "预期误差，mm#", "不用模型，mm#", "保持原样的原因",
    ),
    worst_first="最差的在前。",
    worst_programs="{total} 个程序中最差的 {shown} 个，最差的在前；CSV 和 JSON 文件包含全部。",
    worst_points="{total} 个点中最差的 {shown} 个，最差的在前；CSV 和 JSON 文件包含全部。",
    from_above="俯视",
    from_the_side="侧视",
    axis="{}，mm",
    axis_of="{axis}，mm，{about}",
    step="{} 至 {}",
    not_known="未知",
    excluded_label="保持原样",
    lines=("第 {} 行", "第 {} 行"),
    more_lines="{} 及另外 {} 行",
    more_programs=("{} 及另外 {} 个程序", "{} 及另外 {} 个程序"),
)  # fmt: skip
TEXTS: dict[Locale, ReportTexts] = {"en": ENGLISH, "de": GERMAN, "es": SPANISH, "zh": CHINESE}


@dataclass(frozen=True, slots=True)
class ReportLanguage:
    """A language of a report: its own words, what others say, and numbers."""

    locale: Locale
    texts: ReportTexts
    say: Callable[[str], str]
    number: Callable[[str], str]
    join: Callable[[Iterable[str]], str]  # sentences

    @classmethod
    def for_locale(cls, locale: Locale, tables: Translations | None = None) -> "ReportLanguage":
        """Return a language, with the tables of the built pages unless others are given."""
        found = load_translations(locale) if tables is None else tables
        return cls(locale, TEXTS[locale], found.translate, found.format_number, found.join_sentences)


def count_with_noun(count: int, forms: Forms) -> str:
    """Return a count with its noun."""
    return forms[count != 1].format(count)
