"""What the rows of a sweep have to say: best runs, what matters, what trades off, which drive is best, what holds."""

from twin.studies.sweep.statistics.ranking import USUAL_METRICS, best, usual_metric, value

__all__ = ["USUAL_METRICS", "best", "usual_metric", "value"]
