"""The table of docs/validation.md."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from twin.studies.result import markdown

BEGIN = "<!-- from here on written by make validation -->\n"
HEAD = ("", "what is compared", "made by", "difference", "at most", "")


def table(facts: Mapping[str, Any]) -> str:
    """What docs/validation.md ends with.

    Args:
        facts: as in docs/validation.json.
    """
    rows: Sequence[Mapping[str, Any]] = facts["findings"]
    verdicts = Counter(row["verdict"] for row in rows)
    others = "".join(f", {count} {verdict}" for verdict, count in sorted(verdicts.items()) if verdict != "holds")
    made = f"{facts['platform']}, at commit {facts['commit']}" if "commit" in facts else facts["platform"]
    lines = [f"On {made}: {verdicts['holds']} of {len(rows)} hold{others}.", ""]
    lines += [markdown(HEAD, map(_cells, rows)), "", "Why these bounds, and where the differences come from:", ""]
    for reason in dict.fromkeys(row["reason"] for row in rows):
        bounds = {f"`{row['name']}`, {row['bound']:g}" for row in rows if row["reason"] == reason}
        lines.append(f"- {'; '.join(sorted(bounds))}: {reason}.")
    remarks = [f"- `{row['name']}`, {row['claim']}: {row['remark']}." for row in rows if row["remark"]]
    return "\n".join([*lines, *(["", "Without a difference:", "", *remarks] if remarks else [])]) + "\n"


def rewritten(page: str, facts: Mapping[str, Any]) -> str:
    """`page` with the table of `facts` in place of the one it has.

    Raises:
        ValueError: the page does not say where the table begins.
    """
    prose, found, _ = page.partition(BEGIN)
    if not found:
        raise ValueError(f"the page lacks the line {BEGIN.strip()}")
    return f"{prose}{BEGIN}\n{table(facts)}"


def _cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    versions = ", ".join(f"{name} {version}" for name, version in row["versions"].items())
    source = row["source"] + (f" ({versions})" if versions else "")
    difference = ""
    if row["difference"] is not None:
        where = f" {row['unit']}, `{row['quantity']}`" if row["difference"] else ""
        difference = f"{row['difference']:.2g}{where}"
    return f"`{row['name']}`", row["claim"], source, difference, f"{row['bound']:g}", row["verdict"]
