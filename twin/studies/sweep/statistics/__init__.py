"""Statistics of a sweep: best runs, sensitivities, trade-offs, ranking of drives, share within limits."""

from twin.studies.sweep.statistics.ranking import USUAL_METRICS, best, usual_metric, value

__all__ = ["USUAL_METRICS", "best", "usual_metric", "value"]
