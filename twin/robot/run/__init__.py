"""One run: an experiment assembled, stepped in slices, watched and recorded as it goes."""
