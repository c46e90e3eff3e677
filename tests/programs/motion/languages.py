"""The languages of the campaign."""

from tests.programs.motion import abb, kuka, universal_robots
from tests.programs.motion.campaign import MotionLanguage

LANGUAGES = {
    "abb": MotionLanguage("abb", "abb_irb120", abb.generate, abb.interpret),
    "kuka": MotionLanguage(
        "kuka",
        "kuka_kr6_r900",
        kuka.generate,
        kuka.interpret,
        (("1", (0, 0, 0.08)),),
        tuple(kuka.BASES.items()),
    ),
    "universal_robots": MotionLanguage(
        "universal_robots", "ur5", universal_robots.generate, universal_robots.interpret
    ),
}
