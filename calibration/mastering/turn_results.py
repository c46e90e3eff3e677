"""What a recovery of lost turns answers."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class GateCheck:
    """One condition of acceptance, with a sentence for a technician."""

    name: str
    passed: bool
    found: float
    limit: float
    sentence: str
    unit: str = "1"  # of both figures, in SI


@dataclass(frozen=True, slots=True)
class TurnRecovery:
    """The lost counts that the captures show, and whether they may be used.

    ``mode`` is "memory" (nothing was lost but the controller's own data), "turns" (whole turns only: exact),
    "motor" (``replaced_axes`` are off by real amounts), "all" (every reference lost), "geometry" (the robot or
    the wire changed: refused) or "undecided". The true count of motor j is
    ``read + counts_per_turn * offset_turns[j]``; ``turns`` are the nearest whole ones.
    """

    mode: str
    accepted: bool
    reason: str
    turns: tuple[int, ...]
    replaced_axes: tuple[int, ...]
    offset_turns: tuple[float, ...]
    offset_u_rad: tuple[float, ...]  # of the joints, k = 2; 0.0 where all motors that turn one are exact
    counts_at_zero: tuple[int, ...]
    gate: tuple[GateCheck, ...]
    poses_needed: int
    next_joints_rad: tuple[tuple[float, ...], ...]  # where to measure next; joints of the healthy robot
    suspect_capture: int | None
    changed_part: str
    success_probability: float
    sigma_turns: tuple[float, ...]
    chi_square: float
    degrees_of_freedom: int
    captures: int
    offset_covariance: tuple[tuple[float, ...], ...]  # turns^2
    doubt_sigmas: float = 0.0  # how far the motor that fits whole turns worst is from one, the others held
    # Where the equipment is not as recorded: its change in the deviations of `Equipment`, and the covariance.
    equipment_change: tuple[float, ...] = ()
    equipment_covariance: tuple[tuple[float, ...], ...] = ()
    blind_turns: tuple[float, ...] = ()  # a new motor this near a whole turn would look like lost turns
