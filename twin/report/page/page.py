"""The report page: its sections gathered and written as one file."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

from twin.kernel.process.job import seen_from_here
from twin.kernel.writing import finite, made_folder, write_text
from twin.report.page.markup import DataBlock, Markup, dark_filter, element, joined, section
from twin.report.page.panels import curves, scene
from twin.report.page.picture import picture
from twin.report.page.run import ReportRun, report_runs
from twin.report.page.sections import sections, verdict_section
from twin.report.page.verdict import verdict
from twin.studies.answer import Answer
from twin.studies.steps import Say, silent

if TYPE_CHECKING:
    from twin.studies.accuracy.budget import Budget


ASSETS = files("twin.report.page") / "assets"
SCRIPTS = ("data", "clock", "look", "plot", "plots", "scene", "player", "page")
"""In an order in which each finds what it needs."""
REPORT = "report.html"
SEVERAL = Path("results/report")


def write_report(
    runs: Sequence[Path],
    out: Path | None = None,
    budget: bool = False,
    say: Say = silent,
) -> Answer:
    """Write the report on the runs meant by `runs`.

    Args:
        runs: at least one; see `report_runs`.
        out: the file; None: report.html beside the recording, of several runs in results/report.
        budget: run each experiment again without its imperfections, one after the other, for its accuracy budget.
        say: called with what is being run.

    Raises:
        RecordingRefused: a recording is missing, empty, damaged or foreign.
        InputRefused: a run is given twice, holds no samples or has no budget, or there can be no file there.
        NotWritten: the disk refuses; a page that was there stays.
        ComponentFailed: a component failed while a budget was made.
    """
    shown = report_runs(runs)
    path = out or (shown[0].recording.path.parent if len(shown) == 1 else SEVERAL) / REPORT
    html, headline = report_page(shown, [_budget(run, say) for run in shown] if budget else ())
    made_folder(path.parent)
    write_text(path, html)
    page = seen_from_here(path)
    return Answer(f"{headline}\n  page  {page}", {"headline": headline, "page": str(page)})


def report_page(runs: Sequence[ReportRun], budgets: Sequence["Budget"] = ()) -> tuple[str, str]:
    """(HTML, first sentence). The same recordings, summaries and budgets (of each run, or none) give the same text."""
    judged = verdict(runs)
    with picture(runs, judged) as drawn:
        data, factor = _data(runs)
        parts = sections(runs, judged, drawn(), budgets)
    title = runs[0].title if len(runs) == 1 else f"{len(runs)} runs compared"
    links = [("verdict", "Verdict"), ("replay", "Replay"), *((part.key, part.title) for part in parts)]
    html = Template((ASSETS / "page.html").read_text(encoding="utf-8")).substitute(
        title=joined([title]),
        subtitle=element("p", " | ".join(run.label for run in runs)),
        style=(ASSETS / "page.css").read_text(encoding="utf-8"),
        dark=dark_filter(),
        contents=joined([element("a", text, href=f"#{key}") for key, text in links]),
        verdict=verdict_section(runs, judged),
        remark=_remark(data["scenes"], factor),
        chooser=_chooser(runs, data["scenes"]),
        sections=joined([part.html for part in parts]),
        version=joined([version("twin")]),
        data=_json(data),
        script="\n".join((ASSETS / f"{name}.js").read_text(encoding="utf-8") for name in SCRIPTS),
    )
    return html, judged.headline


def _data(runs: Sequence[ReportRun]) -> tuple[dict[str, Any], int]:
    """What the scripts of the page work on, and the factor by which samples are thinned."""
    blocks = [DataBlock() for _ in runs]
    # side by side: what adds up and compresses holds no lock
    with ThreadPoolExecutor(2) as pool:
        pool.map(lambda run: run.sha256, runs)
        panels, factor = curves(runs, blocks)
        scenes = [scene(run, block) for run, block in zip(runs, blocks, strict=True)]
        texts = pool.map(DataBlock.text, blocks)
    data = {
        "end": max(run.end for run in runs),
        "runs": [{"label": run.label, "block": text} for run, text in zip(runs, texts, strict=True)],
        "panels": panels,
        "scenes": scenes,
        "events": [
            {"run": number, "t": event.time, "level": event.level, "text": event.text}
            for number, run in enumerate(runs)
            for event in run.recording.events
        ],
    }
    return data, factor


def _budget(run: ReportRun, say: Say) -> "Budget":
    # what runs experiments takes a while to load
    from twin.robot.assembly.load import recorded_experiment
    from twin.studies.accuracy.budget import accuracy_budget

    experiment = recorded_experiment(run.recording.metadata, run.recording.path)
    return accuracy_budget(experiment, lambda what, share=None: say(f"{run.label}: {what}", share))


def _remark(scenes: Sequence[dict[str, Any] | None], factor: int) -> Markup:
    notes = []
    if not any(scenes):
        notes.append("Nothing here says where the robot's joints were, so there is no player.")
    if factor > 1:
        notes.append(f"So much was recorded that the curves show the extremes of every {2 * factor} samples only.")
    return joined([element("p", text) for text in notes])


def _chooser(runs: Sequence[ReportRun], scenes: Sequence[dict[str, Any] | None]) -> Markup:
    """Which run the player shows; nothing to choose with one."""
    if len(runs) == 1:
        return Markup()
    options = [
        element("option", run.label, value=str(number))
        for number, (run, its) in enumerate(zip(runs, scenes, strict=True))
        if its
    ]
    return element("label", "Run ", element("select", *options, id="run"))


def _json(data: object) -> str:
    """JSON that cannot end the script element it stands in, whatever texts it holds."""
    return json.dumps(finite(data), ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


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
