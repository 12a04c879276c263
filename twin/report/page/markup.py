"""HTML in which nothing that came from a user is taken for markup."""

from collections.abc import Iterable, Sequence
from html import escape


class Markup(str):
    """HTML as it stands in the page; any other text is escaped where it is put into an element."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str) -> Markup:
    """`<tag attribute="...">children</tag>`; of an attribute's name `class_` gives class and `data_t` data-t."""
    named = "".join(f' {key.strip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items())
    return Markup(f"<{tag}{named}>{joined(children)}</{tag}>")


def joined(children: Iterable[str]) -> Markup:
    """Children one after the other, those that are no markup escaped."""
    return Markup("".join(child if isinstance(child, Markup) else escape(child) for child in children))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], label: str) -> Markup:
    """A table that scrolls in its own box where the screen is too narrow for it; the first cell heads its row.

    Args:
        head: titles of the columns.
        rows: cells, as many in each.
        label: what it shows, for who does not see it.
    """
    titles = element("tr", *(element("th", title, scope="col") for title in head))
    lines = [
        element("tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:])) for row in rows
    ]
    inside = element("table", element("thead", titles), element("tbody", *lines))
    return element("div", inside, class_="scroll", tabindex="0", role="region", aria_label=label)


def section(key: str, title: str, *children: str) -> Markup:
    """A section of the page with its heading."""
    heading = element("h2", title, id=f"{key}-title")
    return element("section", heading, *children, id=key, aria_labelledby=f"{key}-title")
