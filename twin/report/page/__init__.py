"""A report: one HTML file that needs neither network nor server."""

DRAW_JOB = "twin.report.page.draw_job:draw_picture"
"""The job of a process that draws what is in a page; here, for importing it means importing what draws."""
