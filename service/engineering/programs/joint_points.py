"""Points in joint angles whose program names no frame: a home position, or every point of a pulse job.

Nothing in the file tells whether such a point belongs to the work. One that does and is not moved meets the work;
one that does not and is moved is no longer the home that interlocks wait for. So it must be stated.
"""

from typing import Literal, TypeAlias

JointPoints: TypeAlias = Literal["move", "keep"]
UNDECIDED = "it is in joint angles and names no frame: say whether such points move with the work"
