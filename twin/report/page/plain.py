"""Pages without scripts: a headline, links, sections."""

from collections.abc import Sequence
from importlib.metadata import version
from string import Template

from twin.report.page.dark import dark_filter
from twin.report.page.markup import Markup, element, joined, section
from twin.report.page.page import ASSETS


def plain_page(
    title: str,
    subtitle: str,
    sections: Sequence[tuple[str, str, Markup]],
    links: Sequence[tuple[str, str]],
    made_of: str = "",
) -> str:
    """The HTML of a page.

    Args:
        title, subtitle: at its head.
        sections: key, title and content of each.
        links: key of a section and text, for the head.
        made_of: what follows "Made by twin VERSION" at its foot.
    """
    return Template((ASSETS / "plain.html").read_text(encoding="utf-8")).substitute(
        title=joined([title]),
        subtitle=element("p", subtitle),
        style=(ASSETS / "page.css").read_text(encoding="utf-8"),
        dark=dark_filter(),
        contents=joined([element("a", text, href=f"#{key}") for key, text in links]),
        sections=joined([section(*one) for one in sections]),
        version=joined([version("twin")]),
        made_of=made_of,
    )
