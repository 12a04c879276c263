"""What `twin check` found, as text of at most 80 columns: the answer, what deviates, what else has changed."""

import textwrap
from collections import Counter
from collections.abc import Iterable, Sequence

from twin.regression.verdict import Row, Verdict
from twin.report.comparison_text import shown

WIDTH = 80


def check_text(verdicts: Sequence[Verdict], failures: Sequence[str]) -> str:
    """The answer first; of a single check every number, of many only those that deviate.

    Args:
        verdicts: of the checks that could be done. failures: sentences on those that could not.
    """
    lines = [_answer(verdicts, failures)]
    told = verdicts if len(verdicts) == 1 else [verdict for verdict in verdicts if verdict.deviations]
    for verdict in told:
        rows = verdict.rows if len(verdicts) == 1 else verdict.deviations
        lines += ["", f"{verdict.experiment}, {verdict.drive}", *_table(rows)]
        as_it_was = len(verdict.rows) - len(rows)
        lines += [f"  and {as_it_was} as they were"] if as_it_was else []
        lines += [line for note in verdict.notes for line in _wrapped("note", note)]
    # a note that a hundred checks share is told once
    others = Counter(note for verdict in verdicts if verdict not in told for note in verdict.notes)
    lines += [""] * bool(others)
    for note, count in others.items():
        lines += _wrapped("note", f"{note} ({count} checks)" if count > 1 else note)
    lines += [""] * bool(failures)
    for failure in dict.fromkeys(failures):
        lines += _wrapped("not done", failure)
    return "\n".join(lines)


def _answer(verdicts: Sequence[Verdict], failures: Sequence[str]) -> str:
    wrong = [verdict for verdict in verdicts if verdict.deviations]
    missed = f"; {_count(len(failures), 'check')} could not be done" if failures else ""
    if not verdicts:
        return missed.removeprefix("; ")
    experiments, drives = {v.experiment for v in verdicts}, {v.drive for v in verdicts}
    rows = sum(len(verdict.rows) for verdict in verdicts)
    of = f"{_count(len(experiments), 'experiment')}, {_count(len(drives), 'drive')}, {rows} numbers and curves"
    if not wrong:
        return f"All as it was: {of}{missed}"
    words = Counter(row.word for verdict in wrong for row in verdict.deviations)
    told = ", ".join(f"{count} {word}" for word, count in words.most_common())
    return f"{len(wrong)} of {_count(len(verdicts), 'check')} deviate: {told}{missed}\n  of {of}"


def _table(rows: Sequence[Row]) -> Iterable[str]:
    width = max(6, *(len(_name(row)) for row in rows))
    yield f"  {'':7} {'metric':{width}} {'unit':6}{'baseline':>10}{'now':>10}{'bound':>10}"
    for row in rows:
        unit, factor = shown(row.unit)
        numbers = "".join(
            f"{'-' if value is None else format(factor * value, '.4g'):>10}"
            for value in (row.before, row.now, row.bound)
        )
        yield f"  {row.word:7} {_name(row):{width}} {unit:6}{numbers}"


def _name(row: Row) -> str:
    return row.name if row.at is None or row.word == "ok" else f"{row.name} at {row.at:.4g} s"


def _wrapped(head: str, text: str) -> list[str]:
    lines = []
    for part in text.splitlines():
        lines += textwrap.wrap(
            part, WIDTH, initial_indent=f"  {head:9}", subsequent_indent=11 * " ", break_on_hyphens=False,
            break_long_words=False,
        )  # fmt: skip
        head = ""
    return lines


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
