"""The languages of the campaign."""

from tests.programs.motion import abb
from tests.programs.motion.campaign import Language

LANGUAGES = {
    "abb": Language(
        "abb", "abb_irb120", lambda seed: {"gen.mod": abb.generate(seed)}, lambda texts: abb.interpret([*texts.values()])
    ),
}
