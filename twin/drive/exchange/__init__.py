"""Model-exchange FMUs: the equations are theirs, the solver is ours."""
