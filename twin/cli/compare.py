"""`twin compare`: recordings beside the paper's claims."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.paper.claim import Finding
    from twin.paper.score import Score

FIGURES = ("fig4",)
MARKS = {"holds": "ok", "fails": "FAIL", "trivial": "n/a", "not reproducible": "n/a"}
WIDTH = 80


def compare(
    force_position: Annotated[
        Path, typer.Argument(metavar="RUN_FORCE_POSITION", help="Run with force control: folder or .mcap.")
    ],
    position: Annotated[Path, typer.Argument(metavar="RUN_POSITION", help="Run with position control only.")],
    paper: Annotated[str, typer.Option(metavar="FIGURE", help="Figure of the paper to score: fig4.")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where picture and JSON go.")] = Path("results/fig4"),
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of the scorecard.")] = False,
) -> None:
    """Score two runs against the claims of a figure of the paper, and draw the figure.

    A run is its folder, its .mcap file, or results/EXPERIMENT for the latest one.
    Exit code: 0 no claim fails, 1 one does, 2 input refused.
    """
    if paper not in FIGURES:
        raise InputRefused(f"--paper {paper}: expected one of {', '.join(FIGURES)}")
    from twin.paper.fig4_runs import fig4_runs
    from twin.paper.score import fig4_score
    from twin.recording.folder import recording_in
    from twin.recording.reader import read
    from twin.report.fig4 import draw_fig4

    recordings = [read(recording_in(path)) for path in (force_position, position)]
    runs = fig4_runs(*recordings)
    score = fig4_score(runs)
    try:
        out.mkdir(parents=True, exist_ok=True)
        picture, facts = out / f"{paper}.png", out / f"{paper}.json"
        draw_fig4(runs, picture)
        facts.write_text(json.dumps(score.facts(), indent=2) + "\n")
    except OSError as problem:
        raise InputRefused(f"{out}: cannot be written: {problem.strerror}") from None
    if as_json:
        print(json.dumps(score.facts()))
    else:
        print(scorecard(score))
        for recording in recordings:
            if recording.note:
                print(f"  note     {recording.note}")
        print(f"  picture  {picture}\n  verdict  {facts}")
    if score.failed:
        raise SystemExit(1)


def scorecard(score: "Score") -> str:
    """The verdict, then its reasons, at most 80 columns wide."""
    judged = [f for f in score.claims if f.verdict in ("holds", "fails")]
    held = sum(f.verdict == "holds" for f in judged)
    lines = [_two("Fig. 4: hybrid force and position control", f"{held} of {len(judged)} claims hold")]
    lines += [line for finding in score.claims for line in _lines(finding)]
    lines += ["", _two("Judged on the true contact force, force-position run", "")]
    lines += [line for finding in score.quality for line in _lines(finding)]
    lines += ["", "Tuned to meet the figure: " + ", ".join(sorted(key.rpartition(".")[2] for key in score.tuned))]
    lines += [f"Out of scope: {text}" for text in score.out_of_scope]
    return "\n".join(part for line in lines for part in _folded(line))


def _two(left: str, right: str) -> str:
    return f"{left}{right:>{WIDTH - len(left)}}".rstrip()


def _lines(finding: "Finding") -> list[str]:
    mark, text = MARKS[finding.verdict], finding.claim.text
    head = f"  {mark:4} {text:47} {finding.measured:>10}  {finding.expected:>12}".rstrip()
    return [head, f"       {finding.reason}"] if finding.reason else [head]


def _folded(line: str) -> list[str]:
    import textwrap

    if len(line) <= WIDTH:
        return [line]
    indent = " " * (len(line) - len(line.lstrip()))
    return textwrap.wrap(line, WIDTH, subsequent_indent=indent + "  ", drop_whitespace=True)
