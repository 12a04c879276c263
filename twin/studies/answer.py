"""What a study comes to, and how it is asked: every question in the same way."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.runs.guard.job import function_called
from twin.writing import made_folder, write_json

if TYPE_CHECKING:
    from twin.runs.guard.reporter import Reporter

JOB = "twin.studies.answer:answered"


@dataclass(frozen=True)
class Answer:
    """What a study says to whoever asked.

    Attributes:
        text: for people, at most 80 columns.
        facts: for programs; JSON can hold them.
        exit_code: of a command that asks this; 0 or, of what was judged, 1 and more if it failed.
    """

    text: str
    facts: Any
    exit_code: int = 0


def judged(
    name: str,
    folder: Path,
    text: str,
    facts: Any,
    draw: Callable[[Path], None],
    holds: bool,
    notes: Sequence[str] = (),
) -> Answer:
    """The answer of a comparison: text, then notes and where its files are; picture and verdict written.

    Args:
        name: of the files.
        folder: where they go.
        text: the comparison's own.
        facts: of the verdict.
        draw: draws the picture, into a file.
        holds: False: exit code 1.
        notes: on what was compared.

    Raises:
        InputRefused, NotWritten: the folder or the disk refuses.
    """
    picture, verdict = made_folder(folder) / f"{name}.png", folder / f"{name}.json"
    draw(picture)
    write_json(verdict, facts)
    lines = [text, *(f"  note     {note}" for note in notes), f"  picture  {picture}", f"  verdict  {verdict}"]
    return Answer("\n".join(lines), facts, 0 if holds else 1)


def answered(
    reporter: "Reporter", study: str, asked: dict[str, Any], formats: Sequence[str] = (), columns: int = 2
) -> dict[str, Any]:
    """The answer of a study, taken apart; a job of the guard.

    Notes {"say": what is being done, "share": of all that is over, or None}.

    Args:
        study: "module:function"; the function takes what is asked, and `say`, which it tells what it is doing.
        asked: its arguments.
        formats, columns: of pictures for a paper, see `for_paper`.
    """

    def say(what: str, share: float | None = None, /) -> None:
        reporter.note(say=what, share=share)

    if not formats:
        return vars(function_called(study)(**asked, say=say))
    # most answers draw nothing, and it takes a while to load
    from twin.studies.paper_figure import for_paper

    with for_paper(formats, columns) as paper:
        answer = function_called(study)(**asked, say=say)
    files = [str(path) for path in paper.written]
    lines = [answer.text, *(f"  {Path(file).suffix[1:]:<8} {file}" for file in files)]
    return vars(replace(answer, text="\n".join(lines), facts=answer.facts | {"pictures": files}))
