"""Pages from recordings: reports, comparisons and the explorer."""
