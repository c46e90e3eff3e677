"""What each setting is called and what a person is told about it; written once for pages, terminal and JSON schema.

A setting's text stands in its annotation: ``Annotated[int, Field(ge=1), describe_setting("Touches", …)]``. Texts that
several procedures share are constants here. The page's other languages are in `web/src/locales/settings`.
"""

from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field

SettingGroup = Literal["what", "tool", "place", "effort", "limits", "doubt", "motion", "shapes", "technical"]
GROUP_NAMES: Mapping[SettingGroup, str] = {
    "what": "What to do",
    "tool": "Tool and instrument",
    "place": "Where things are",
    "effort": "How much is measured",
    "limits": "How good the result must be",
    "doubt": "How well things are known beforehand",
    "motion": "Motion",
    "shapes": "Shapes in the cell",
    "technical": "Technical details",
}
MAX_BASIC = 4  # inputs of a procedure before those for an engineer


def describe_setting(  # noqa: PLR0913  each is one thing that a page shows
    label: str,
    help_text: str,
    group: SettingGroup,
    *,
    unit: str = "",
    basic: bool = False,
    drawing: str = "",
    choices: Mapping[str, str] | None = None,
    axes: bool = False,
) -> Any:
    """Return the text of a setting for its annotation.

    ``unit`` is SI ("m", "rad", "m/s", "rad/s", "count" of an encoder, "1" for a plain number), empty where the value
    is no number. A ``basic`` setting is one that a technician knows; ``drawing`` names a picture of a place or
    direction; ``choices`` says each value of a choice in words; ``axes`` are counted from 1, and shown and
    taken by the names of the pendant.
    """
    extra: dict[str, Any] = {"x-group": GROUP_NAMES[group], "x-unit": unit, "x-basic": basic}
    if drawing:
        extra["x-drawing"] = drawing
    if choices:
        extra["x-choices"] = dict(choices)
    if axes:
        extra["x-axes"] = True
    return Field(title=label, description=help_text, json_schema_extra=extra)


SAMPLES = describe_setting(
    "Readings per pose",
    "How often the instrument is read at one pose; the mean is taken.",
    "effort",
    unit="1",
)
SEED = describe_setting(
    "Start number of the choice of poses",
    "Another number chooses other poses from those that are possible.",
    "technical",
    unit="1",
)
RETAKES = describe_setting(
    "Repeats of doubtful readings",
    "So many readings that contradict the others are taken once more.",
    "effort",
    unit="1",
)
CANDIDATES = describe_setting(
    "Poses to choose from",
    "From so many possible poses the most telling ones are chosen; more take longer to plan.",
    "technical",
    unit="1",
)
ROOM = describe_setting(
    "Space and speed of the motion",
    "Where the arm may be and how fast it may move while it measures.",
    "motion",
)
ACCURACY_CLASS = describe_setting(
    "How good it must be",
    "The class of limits by which the result passes or fails; B is usual.",
    "limits",
    basic=True,
    choices={"A": "A: precise", "B": "B: general", "C": "C: coarse"},
)
OWN_LIMITS = describe_setting(
    "Own limits", "Figures of your specification in place of those of the class.", "limits"
)
WRITE_ANYWAY = describe_setting(
    "Reason to write without proof",
    "With a reason here an engineer has the result written although it is not proved; it stands on the certificate.",
    "limits",
)
INSTRUMENT = describe_setting(
    "Measure with",
    "The instrument that is mounted for this run.",
    "tool",
    basic=True,
    choices={"wire": "draw-wire gauge", "tracker": "tracker or other point instrument"},
)
EVIDENCE = describe_setting(
    "Prove the position with",
    "What shows afterwards where the arm really stands: lengths of a draw-wire, or places it comes back to.",
    "tool",
    basic=True,
    choices={"wire": "draw-wire gauge", "places": "touched points, a seat or targets"},
)
TIP_IN_FLANGE = describe_setting(
    "Pointer tip, seen from the flange",
    "How far the tip is from the middle of the flange along x, y and z of the flange.",
    "tool",
    unit="m",
    basic=True,
    drawing="tip",
)
FRAME_NUMBER = describe_setting(
    "Number of the user frame",
    "The user frame that is written, as the pendant counts it.",
    "what",
    unit="1",
    basic=True,
)
TOOL_NUMBER = describe_setting(
    "Number of the tool",
    "The tool frame that is written, as the pendant counts it.",
    "what",
    unit="1",
    basic=True,
)
CHECK_ABOVE = describe_setting(
    "One more touch above the surface", "Catches points that were touched in the wrong order.", "effort"
)
TOUCH_SIGMA = describe_setting(
    "Spread of one touch",
    "How much one touch by hand scatters in x, y or z (standard deviation).",
    "doubt",
    unit="m",
)
MAX_TOUCHES = describe_setting(
    "Most touches",
    "Further touches are asked for up to this number where they are enough.",
    "effort",
    unit="1",
)
MOUTH_AT = describe_setting(
    "Where the mouth of the wire looks",
    "A point in the robot's base that the draw-wire's mouth faces; empty: the middle of the work.",
    "place",
    unit="m",
    drawing="mouth",
)
POINTS_IN_TOOL = describe_setting(
    "Points on the end-effector, from the tip",
    "Where hook or target is fixed, in x, y and z of the tool, by the drawing.",
    "place",
    unit="m",
    basic=True,
    drawing="tool",
)
ROUGH_TOOL = describe_setting(
    "Tool, roughly",
    "Where the tip is from the flange and how it is turned, by drawing or tape measure.",
    "place",
    unit="m",
    basic=True,
    drawing="tool",
)
SEAT_SIGMA = describe_setting(
    "Spread of the seat",
    "How exactly hook or target sits on its point each time (standard deviation of one axis).",
    "doubt",
    unit="m",
)
DRAWING_SIGMA = describe_setting(
    "Tolerance of the drawing",
    "How exactly the points are where the drawing has them (standard deviation of one axis).",
    "doubt",
    unit="m",
)
FIXTURE = describe_setting(
    "Name of the fixture",
    "The name under which the fixture's place is stored and found again.",
    "what",
    basic=True,
)
TOLERANCE_COUNTS = describe_setting(
    "Movement while reading",
    "More encoder counts than this between two readings mean that the arm moved.",
    "doubt",
    unit="count",
)
ARM_SIGMA = describe_setting(
    "The arm's own errors",
    "By how much an arm that follows its drawing misses a place in x, y or z (standard deviation).",
    "doubt",
    unit="m",
)
MIN_CAPTURES = describe_setting(
    "Fewest poses", "At least so many poses are measured before the result may be enough.", "effort", unit="1"
)
FIRST_CAPTURES = describe_setting(
    "Poses of the first look",
    "So many poses are measured before the offsets are worked out for the first time.",
    "effort",
    unit="1",
)
MAX_CAPTURES = describe_setting(
    "Most poses",
    "No more poses than these are measured; what is not enough then is said so.",
    "effort",
    unit="1",
)
RULES = describe_setting(
    "How the series is measured", "How many poses, how carefully, and what the motion must keep to.", "effort"
)
SHAPE_NAME = describe_setting(
    "Name of the shape", "What the shape is called on pages and in refusals.", "shapes"
)
RADIUS = describe_setting("Radius of the shape", "Half the thickness of the shape.", "shapes", unit="m")
BOX_LOW = describe_setting(
    "Lowest corner of the workspace",
    "Arm and tool stay above these x, y and z of the base; empty: as in the cell file.",
    "motion",
    unit="m",
    drawing="box",
)
BOX_HIGH = describe_setting(
    "Highest corner of the workspace",
    "Arm and tool stay below these x, y and z of the base; empty: as in the cell file.",
    "motion",
    unit="m",
    drawing="box",
)
TIP_U = describe_setting(
    "Accuracy to reach at the tip",
    "The series ends once the tip is known so well (expanded, k = 2).",
    "limits",
    unit="m",
    basic=True,
)
