"""Reasons why the tool or frame of a position cannot be determined, common to several brands' programs."""

SEVERAL = "the program sets another tool or base for it at different places"
COMPUTED = "its tool or base is set while the program runs"
PASSED_TO_NOT_GIVEN = "its tool or base is passed to a routine that was not given, and may be set there"
SOURCE_OF_TARGET = "a move computes the place that it goes to from it"
CALLED = "a routine that its program calls sets another tool or base"
CALLER = "a routine that calls its program sets the tool or base"
OVERWRITTEN = "the program gives it another value while it runs"
LATER = "its program sets the tool or base below it, or in a branch"
MOVED_BY_UNIT = "its work object is moved by a mechanical unit, which no program file holds"
SEEN_FROM_FLANGE = "it is used with a tool in the cell or a held work object"
ONLY_SEEN_THERE = "another module goes there with a tool or work object that only that module sees"
TURNED_BASE = "an external axis turns its base, and no program file holds how"
EXTERNAL_BASE = (
    "BAS(#EX_BASE) lets an external axis turn its base, with data that no program file holds: set the base as "
    "EK(…, BASE_DATA[n]), and state the axis in the project as [[positioner]]"
)
UNKNOWN_FRAMES = frozenset(
    (SEVERAL, COMPUTED, SOURCE_OF_TARGET, LATER, CALLED, CALLER, EXTERNAL_BASE)
)  # of which joint angles do not depend
MOVED_FRAMES = frozenset((MOVED_BY_UNIT, TURNED_BASE))  # a project may state what these lack
