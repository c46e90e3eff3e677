"""The process that attends one cell."""

from cellcal.service.gc_freeze import collect_rarely

collect_rarely()
