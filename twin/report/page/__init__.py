"""A report: one HTML file that needs neither network nor server."""

DRAWN = "twin.report.page.drawn:drawn"
"""The job of a process that draws what is in a page; here, for importing it means importing what draws."""
