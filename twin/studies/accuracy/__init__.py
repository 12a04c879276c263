"""Accuracy budget: the contribution of each imperfection to the force error, in newtons."""
