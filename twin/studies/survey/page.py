"""A survey as a page of the documentation and as a few lines, from its data."""

import re
from collections import Counter
from collections.abc import Mapping
from typing import Any

from twin.studies.lines import counted, labelled, markdown
from twin.studies.reference.bare_run import TOLERANCE
from twin.studies.reference.outcome import WORDS

HEAD = """# Which FMUs work

What came of the FMUs that were tried, each by itself and in a process of its own: the reference experiments that came
with it ([FMI-LS-REF](drives_method.md#what-came-with-an-fmu), or the files of the FMI Cross-Check beside it), and
without such its default experiment, with its own start values and no inputs. Whether it is a drive is another question:
*drive* says that names, units and causalities fit the [contract](drives_reference.md#the-contract) as they are; most
others need a mapping.

This page is made from `docs/compatibility.json` by `twin drive survey`; the FMUs are their makers' and no part of this
project. An FMU runs with the rights of who starts it: a survey is for FMUs that one trusts.
"""


def page_text(facts: Mapping[str, Any]) -> str:
    """The page, Markdown."""
    tried = (
        f"Tried on {facts['platform']}: {counted(len(facts['fmus']), 'FMU')}, each with the beginning of its SHA-256."
    )
    lines = [HEAD, f"{tried} Held to results within {TOLERANCE}.", ""]
    words = Counter(row["word"] for row in facts["fmus"])
    lines += [markdown(["word", "FMUs", "meaning"], ([word, str(words[word]), WORDS[word]] for word in WORDS)), ""]
    for source, origin in facts["sources"].items():
        rows = [row for row in facts["fmus"] if row["source"] == source]
        lines += [f"## {source or 'FMUs'}", "", *([f"{origin}", ""] if origin else [])]
        lines += [markdown(["FMU", "made with", "FMI", "tried", "came out", "in a sentence"], map(_cells, rows)), ""]
    return "\n".join(lines)


def survey_text(facts: Mapping[str, Any]) -> str:
    """How many came out how, then those that did not run."""
    words = Counter(row["word"] for row in facts["fmus"])
    lines = [
        f"{counted(len(facts['fmus']), 'FMU')}: " + ", ".join(f"{words[word]} {word}" for word in WORDS if words[word])
    ]
    for row in facts["fmus"]:
        if row["word"] not in ("agrees", "ran"):
            lines += labelled(
                row["word"], f"{row['file']}: {row['detail'].removeprefix(row['file'] + ': ')}", whole=True
            )
    return "\n".join(lines)


def _cells(row: Mapping[str, Any]) -> list[str]:
    kinds = ", ".join(row.get("kinds", ()))
    name = f"{row['file']} ({row['sha256'][:8]}){', drive' if row['drive'] else ''}"
    detail = row["detail"].removeprefix(f"{row['file']}: ")
    made = (row.get("tool") or "not stated", f"{row.get('fmi', '')} {kinds}".strip())
    return [_plain(text) for text in (name, *made, row["tried"], row["word"], detail)]


def _plain(text: str) -> str:
    """Words of strangers in a cell, in which nothing is Markdown or HTML."""
    text = text.replace("&", "&amp;").replace("<", "&lt;")
    return re.sub(r"([\\`*_\[\]|!])", r"\\\1", text)
