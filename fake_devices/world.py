"""The truth of a fake cell: one clock, the arms, and what they are hooked to.

Imitates
    The shop floor.
Source
    The [fake] table of a cell file: ``seed`` draws everything hidden, ``time_factor`` sets the clock.
Modelled
    Arms by name, each with its own hidden errors; any other things devices share, by their owners.
Not modelled
    Collisions between arms, wire and furniture; people.
"""

import numpy as np

from fake_devices.arm import Arm, generator
from fake_devices.clock import Clock


class World:
    """Everything that is, known to the fakes and to the control door only."""

    def __init__(self, seed: int = 1, time_factor: float = 1.0, *, hidden: bool = True) -> None:
        self.seed, self.hidden = seed, hidden
        self.clock = Clock(time_factor)
        self.arms: dict[str, Arm] = {}

    def add_arm(self, name: str, model_name: str) -> Arm:
        """Put up one arm; ``name`` is its robot's name in the cell file."""
        arm = Arm.from_model(model_name, self.seed, self.hidden, name=name, clock=self.clock)
        self.arms[name] = arm
        return arm

    def dice(self, *labels: str) -> np.random.Generator:
        """Return the random generator of one named purpose."""
        return generator(self.seed, *labels)
