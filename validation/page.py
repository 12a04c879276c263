"""The table of docs/validation.md."""

from collections.abc import Mapping, Sequence
from typing import Any

from twin.studies.lines import counted, markdown

BEGIN = "<!-- from here on written by make validation -->\n"
HEAD = ("", "what is compared", "made by", "difference", "at most", "")


def table(facts: Mapping[str, Any]) -> str:
    """What docs/validation.md ends with.

    Args:
        facts: as in docs/validation.json.
    """
    rows: Sequence[Mapping[str, Any]] = facts["findings"]
    verdicts = [row["verdict"] for row in rows]
    summary = ", ".join(
        f"{verdicts.count(verdict)} {verdict}"
        for verdict in ("holds", "EXCEEDED", "FAILED", "not run")
        if verdict in verdicts
    )
    lines = [f"{counted(len(rows), 'comparison')} on {facts['platform']}: {summary}.", ""]
    lines += [markdown(HEAD, map(_cells, rows)), ""]
    lines += ["Why these bounds, and where the differences come from:", ""]
    for reason in dict.fromkeys(row["reason"] for row in rows):
        names = dict.fromkeys(
            f"`{row['name']}`, at most {_amount(row, 'bound')}" for row in rows if row["reason"] == reason
        )
        lines.append(f"- {'; '.join(names)}: {reason}.")
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
    versions = " ".join(f"{name} {version}" for name, version in (row["versions"] or {}).items())
    difference = "" if row["difference"] is None else f"{_amount(row, 'difference')} (`{row['quantity']}`)"
    if row["difference"] == 0.0:
        difference = "0"
    source = row["source"] + (f" ({versions})" if versions else "")
    return f"`{row['name']}`", row["claim"], source, difference, _amount(row, "bound"), row["verdict"]


def _amount(row: Mapping[str, Any], key: str) -> str:
    return "0" if row[key] == 0.0 else f"{row[key]:.1e} {row['unit']}".strip()
