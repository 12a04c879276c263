"""Reports: one HTML file that needs neither network nor server."""

DRAW_JOB = "twin.report.page.draw_job:draw_picture"
"""Job of a process that draws a page's picture; defined here because importing its module loads the drawing library."""
