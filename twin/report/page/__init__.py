"""A report: one HTML file that needs neither network nor server."""
