"""A process that serves for weeks leaves what it loaded at its start out of the collector's rounds.

A full collection looks at every object there is: with our libraries loaded it stopped the loop for 0.1 to 0.2 s,
every few seconds where a thousand cells send. What came with the start never goes: looking again finds nothing.
"""

import gc


def freeze_startup_objects() -> None:
    """Leave everything there is by now out of later collections; may be called again after more was loaded."""
    gc.freeze()


def collect_rarely() -> None:
    """Search for garbage after 50 000 new objects, not after 700: before a start loads what it needs.

    A start makes some 140 000 objects that stay; the search among them took a sixth of it.
    """
    gc.set_threshold(50_000, 10, 10)
