"""The service and the command line."""

import gc

# A start makes some 140 000 objects that stay: with Python's threshold of 700 the search for garbage among them
# took a sixth of it.
gc.set_threshold(50_000, 10, 10)
