"""What the rows of a sweep have to say: best runs, what matters, what trades off, which drive is best, what holds."""

from twin.sweep.statistics.ranking import best, usual_metric, value

__all__ = ["best", "usual_metric", "value"]
