"""Statistics of a sweep: best runs, sensitivities, trade-offs, ranking of drives, share within limits."""
