"""Questions to a study and its answers, the same for every study."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.kernel.process.job import function_called
from twin.kernel.writing import made_folder, write_json
from twin.studies.result import Result, render_text, to_json

if TYPE_CHECKING:
    from twin.kernel.process.reporter import Reporter

JOB = "twin.studies.answer:answered"


@dataclass(frozen=True)
class Answer:
    """The answer of a study to its command.

    Attributes:
        text: for people, at most 80 columns.
        facts: for programs; JSON can hold them.
        exit_code: of a command that asks this; 0 or, of what was judged, 1 and more if it failed.
    """

    text: str
    facts: Any
    exit_code: int = 0


def judged(name: str, folder: Path, result: Result, draw: Callable[[Path], None], notes: Sequence[str] = ()) -> Result:
    """`result` of a comparison with notes and with where its files are; picture and verdict are written.

    Args:
        name: of the files.
        folder: where they go.
        result: with the facts of the verdict.
        draw: draws the picture, into a file.
        notes: on what was compared.

    Raises:
        InputRefused, NotWritten: the folder or the disk refuses.
    """
    files = {"picture": made_folder(folder) / f"{name}.png", "verdict": folder / f"{name}.json"}
    draw(files["picture"])
    write_json(files["verdict"], result.facts)
    return replace(result, body=[*result.body, *(f"  note     {note}" for note in notes)], files=files, label=8)


def answered(
    reporter: "Reporter", study: str, asked: dict[str, Any], formats: Sequence[str] = (), columns: int = 2
) -> dict[str, Any]:
    """The answer of a study, taken apart; a job of the guard.

    Notes {"say": what is being done, "share": of all that is over, or None}.

    Args:
        study: "module:function"; the function takes what is asked, and `say`, which it tells what it is doing, and
            returns a `Result` or an `Answer`.
        asked: its arguments.
        formats, columns: of pictures for a paper, see `for_paper`.
    """

    def say(what: str, share: float | None = None, /) -> None:
        reporter.note(say=what, share=share)

    if not formats:
        return vars(answer_of(function_called(study)(**asked, say=say)))
    # most answers draw nothing, and it takes a while to load
    from twin.studies.figure import for_paper

    with for_paper(formats, columns) as paper:
        answer = answer_of(function_called(study)(**asked, say=say))
    files = [str(path) for path in paper.written]
    lines = [answer.text, *(f"  {Path(file).suffix[1:]:<8} {file}" for file in files)]
    return vars(replace(answer, text="\n".join(lines), facts=answer.facts | {"pictures": files}))


def answer_of(found: Result | Answer) -> Answer:
    """What is printed of a study's result; an answer is one already."""
    return found if isinstance(found, Answer) else Answer(render_text(found), to_json(found), found.exit_code)
