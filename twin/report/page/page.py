"""The report page: sections of text and tables, plots and player in one HTML file."""

import base64
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from twin.kernel.atomic_write import make_folder, write_text
from twin.kernel.errors import InputRefused
from twin.kernel.process.job import relative_path
from twin.kernel.serialise import to_dict
from twin.report.page.markup import DataBlock, Markup, dark_filter, element, join_markup, section, table
from twin.report.page.panels import curves, scene
from twin.report.page.picture import picture
from twin.report.page.run import ReportRun, RunMeasure, key_measures, number_text, report_runs
from twin.report.page.session_sections import (
    SESSION_PANELS,
    alarms,
    boxes,
    gaps,
    is_session,
    origin,
    punctuality,
    require_sessions,
    residuals,
    session_verdict,
    time_button,
)
from twin.report.page.system import is_system, system_sections
from twin.report.page.verdict import PageVerdict, RunGroup, verdict
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.assembly.load import recorded_experiment
from twin.robot.experiment.command_words import options, repeating_words, run_command
from twin.robot.experiment.differences import (
    FROM_ROBOT,
    differing_values,
    flatten,
    name_and_unit,
    recorded_comparable_values,
    robot_values,
    robot_values_text,
    toml_text,
)
from twin.robot.experiment.source import COMMAND_LINE
from twin.studies.accuracy import budget as budgeting
from twin.studies.accuracy.budget import headline
from twin.studies.command import Answer, Say, ignore_progress
from twin.studies.panel import Panel
from twin.studies.paper.claim import ClaimFinding, standing_text, tally
from twin.studies.result import Cell, Column, Table, wrap_text

BUDGET_HEAD = tuple(f"{column.name}, N" for column in budgeting.NUMBER_COLUMNS)
MEANING_HEAD = "meaning"
REASON_HEAD = "why so much, assumed"
VERDICT_MARKS = {
    "holds": ("✓ holds", "good"),
    "fails": ("✗ fails", "bad"),
    "trivial": ("- trivial", ""),
    "not reproduced": ("- not reproduced", ""),
    "reproduced after all": ("✓ reproduced after all", "good"),
    "not scored": ("? not scored", ""),
}
MAX_BOXED_RUNS = 4
"""Maximum number of runs with key numbers next to the verdict."""
MAX_OPEN_CLAIMS = 5
"""Maximum number of claims that are unfolded even if all of them hold."""
VERDICT_LOOKS = {True: ("✓ ", "good"), False: ("✗ ", "bad"), None: ("", "plain")}
PAGE_ASSETS = files("twin.report.page") / "assets"
PAGE_SCRIPTS = ("data", "clock", "look", "plot", "plots", "scene", "player", "page")
"""Scripts of the page, in the order of their dependencies."""
REPORT_FILE = "report.html"
COMPARISON_FOLDER = Path("results/report")
FORCE_KEY = Markup('<span class="true">true</span> <span class="estimated">estimated</span>')
SESSION_KEY = Markup(
    '<span class="estimated">by the robot\'s counts</span>; <span class="true">plant model</span>, its force and pose'
)
Section = tuple[str, str, Markup]
"""Key, title and content of a section; the title is also its text in the table of contents."""


def accuracy(budget: budgeting.Budget, label: str) -> Markup:
    """Return the report's accuracy section: causes of the force error, the twin's own error, effects, wrong beliefs."""
    found, why = headline(budget), budgeting.details(budget)
    together = ("all of them", budget.bias, None, budget.together, "sum of biases, root of squares")
    added = ("all of them", None, None, budget.parameters, "root of the sum of squares")
    causes = [*map(_row, budget.contributions_of("imperfection")), together, _row(budget.as_is)]
    beliefs = [*map(_row, budget.contributions_of("parameter")), added]
    others = (
        f"None of this is in the run: each line is another, whose controller believes otherwise. {_capitalise(why[1])}."
    )
    return join_markup(
        [
            element("p", f"{_capitalise(found)}. {_capitalise(why[0])}."),
            _table("cause", MEANING_HEAD, causes, f"causes of the force error of {label}"),
            element("h3", "The twin itself"),
            _table(
                "cause", MEANING_HEAD, map(_row, budget.contributions_of("twin")), f"error of the simulation of {label}"
            ),
            element("h3", "Left out; if the robot had"),
            _table("effect", REASON_HEAD, map(_row, budget.contributions_of("effect")), f"effects not in {label}"),
            table(
                ("not modelled", "at most, N", "why"),
                [(what, f"{most:.3f}", why) for what, most, why in budgeting.NOT_MODELLED],
                f"effects not modelled in {label}",
            ),
            element("h3", "If the controller believed"),
            element("p", others),
            _table("belief", REASON_HEAD, beliefs, f"what beliefs would add in {label}"),
        ]
    )


def _table(cause: str, meaning: str, rows: Iterable[Sequence[Cell]], label: str) -> Markup:
    cells = Table((Column(), *budgeting.NUMBER_COLUMNS, Column()), [*rows]).cells
    return table((cause, *BUDGET_HEAD, meaning), cells, label)


def _capitalise(text: str) -> str:
    return text[0].upper() + text[1:]


def _row(one: budgeting.Contribution) -> tuple[Cell, ...]:
    return (*budgeting.row(one), one.meaning)


def source(key: str, origins: Mapping[str, str]) -> str:
    """Return the stated source of the experiment's value of `key`, from its file or from the robot."""
    for filled in FROM_ROBOT:
        if key not in origins and key.startswith(f"{filled}."):
            words = origins.get(f"robot{key.removeprefix(filled)}")
            return f"robot: {words}" if words else ""
    item, _, field = key.rpartition(".")
    return origins.get(key) or (origins.get(item, "") if field else "")


def parameters(run: ReportRun) -> Markup:
    """Return the report's tables of all values of the experiment; those set on the command line are marked."""
    rows = []
    for key, value in flatten(run.values):
        name, unit = name_and_unit(DECLARED_TABLES, key)
        origin = source(key, run.origins)
        words = element("mark", origin) if origin == COMMAND_LINE else origin
        rows.append((name, toml_text(value), unit, words))
    return table(("value of", "is", "unit", "source"), rows, f"parameters of {run.label}")


def differences(runs: Sequence[ReportRun]) -> list[tuple[str, ...]]:
    """Return (name, unit, value in each run ...) of every parameter, FMU and version that differs between runs."""
    return [
        (*name_and_unit(DECLARED_TABLES, key), *values)
        for key, values in differing_values([_recorded_values(run) for run in runs]).items()
    ]


def _recorded_values(run: ReportRun) -> dict[str, str]:
    versions = {f"version of {name}": text for name, text in run.recording.metadata.get("versions", {}).items()}
    return recorded_comparable_values(DECLARED_TABLES, run.recording.metadata, run.recording.path) | versions


def command(run: ReportRun) -> str:
    """Return the command that reproduces a recorded run, in the folder where it was made."""
    return run_command(repeating_words(run.summary, run.name, options(run.values, run.origins)))


def provenance(run: ReportRun) -> Markup:
    """Return the report's section on origin: command, seed, recording hash, versions and experiment of a run."""
    versions = run.recording.metadata.get("versions", {})
    rows = [
        ("command of its experiment" if run.recording.deviations else "command", element("code", command(run))),
        ("seed of the noise", toml_text(run.values.get("seed", 0))),
        ("recording", run.recording.path.name),
        ("its sha256", element("code", run.sha256)),
        ("versions", ", ".join(f"{name} {text}" for name, text in versions.items())),
    ]
    values = json.dumps(run.values, indent=2, ensure_ascii=False)
    link = "data:application/json;base64," + base64.b64encode(values.encode()).decode("ascii")
    whole = element("details", element("summary", "The whole experiment, as it was checked"), element("pre", values))
    save = element("a", "Save it as JSON", href=link, download=f"{run.name}.json")
    same = ["The same versions on the same kind of machine give the same recording, byte for byte."]
    words = [element("p", f"{text[0].upper()}{text[1:]}.") for text in run.recording.deviations or same]
    return join_markup([table(("", "is"), rows, f"provenance of {run.label}"), *words, element("p", save), whole])


def drives(run: ReportRun) -> Markup:
    """Return the report's table of a run's FMUs: joint, file, model, FMI version, tool, hash, settings, mapping."""
    joints: dict[str, list[str]] = {}
    for name, fmu in run.fmus.items():
        joints.setdefault(json.dumps(fmu), []).append(name.removeprefix("drive_"))
    rows = []
    for text, names in joints.items():
        fmu = json.loads(text)
        given = fmu["set"] | ({"tolerance of its solver": fmu["tolerance"]} if fmu["tolerance"] else {})
        given |= {"solver": fmu["solver"]} if fmu["solver"] else {}
        given |= {"longest step of the solver (s)": fmu["solver_step"]} if fmu["solver_step"] else {}
        settings = ", ".join(f"{key} = {toml_text(value)}" for key, value in given.items())
        rows.append(
            (
                ", ".join(names),
                fmu["file"],
                fmu["model"],
                fmu["fmi"] + (" model exchange" if fmu["kind"] == "model_exchange" else ""),
                fmu["generation_tool"] or "not stated",
                element("code", fmu["sha256"]),
                settings or "nothing",
                join_markup([element("div", text) for text in fmu["mapped"]]),
            )
        )
    head = ("joint", "file", "model", "FMI", "made by", "sha256", "set", "signals")
    return table(head, rows, f"drives of {run.label}")


def timing(runs: Sequence[ReportRun]) -> Markup:
    """Return the report's table of the runs' durations, and of each component's time per tick if it was measured."""
    durations = (
        ("simulated", "simulated", "s"),
        ("stepping", "stepping", "s"),
        ("recording", "writing", "s"),
        ("times as fast as the real robot", "real_time_factor", ""),
    )
    rows = [(text, *(_format_value(run.summary.get(key), unit) for run in runs)) for text, key, unit in durations]
    measured = [run.summary.get("microseconds") for run in runs]
    shares: list[dict[str, Any]] = [share if isinstance(share, dict) else {} for share in measured]
    for name in dict.fromkeys(name for share in shares for name in share):
        rows.append((f"{name}, per tick", *(_format_value(share.get(name), "us") for share in shares)))
    text = "Time by component was not measured, or the run did not get to its end." if not any(shares) else ""
    head = ("", *(run.label if len(runs) > 1 else "time" for run in runs))
    return join_markup([table(head, rows, "time that the runs took"), element("p", text)])


def _format_value(value: object, unit: str) -> str:
    return number_text(value, unit) if isinstance(value, float) else "not recorded"


def sections(
    runs: Sequence[ReportRun], verdict: PageVerdict, picture: Markup | None, budgets: Sequence[budgeting.Budget] = ()
) -> list[Section]:
    """Return all sections of the report after the player; `budgets` is empty or has one budget per run."""
    own = dict(zip([run.label for run in runs], budgets, strict=bool(budgets)))
    budget = _of_each(runs, lambda run: accuracy(own[run.label], run.label)) if own else None
    found = [
        ("numbers", "Claims and measures", numbers(runs, verdict)),
        ("figure", "Figure", picture),
        ("accuracy", "Accuracy budget", budget),
        ("events", "Events", _of_each(runs, events)),
        ("drives", "Drives and FMUs", _of_each(runs, drives)),
        ("parameters", "Parameters", _of_each(runs, _folded_parameters)),
        ("timing", "Timing", timing(runs)),
        ("provenance", "Repeat this run", _of_each(runs, provenance)),
    ]
    return [(key, title, html) for key, title, html in found if html is not None]


def verdict_section(runs: Sequence[ReportRun], verdict: PageVerdict, key_numbers: Markup | None = None) -> Markup:
    """Return the first section, next to the player: headline, four numbers per run or `key_numbers`, remarks."""
    mark, look = VERDICT_LOOKS[verdict.good]
    parts = [element("p", f"{mark}{verdict.headline}", class_=f"headline {look}")]
    # more runs are compared in the table of measures
    parts += [key_numbers or _boxes(runs)] if len(runs) <= MAX_BOXED_RUNS else []
    if verdict.remarks:
        parts.append(element("ul", *(element("li", text) for text in verdict.remarks), class_="remarks"))
    return section("verdict", "Verdict", *parts)


def _boxes(runs: Sequence[ReportRun]) -> Markup:
    """Return the report's boxes with four key numbers of the true signals of each run."""
    groups = []
    for run, found in zip(runs, key_measures(runs), strict=True):
        boxes = [element("div", element("strong", m.true_text), element("span", m.name), class_="box") for m in found]
        label = [element("span", run.label, class_="whose")] if len(runs) > 1 else []
        groups.append(element("div", *label, *boxes, class_="boxes"))
    return element("div", *groups, class_="runs")


def numbers(runs: Sequence[ReportRun], verdict: PageVerdict) -> Markup:
    """Return the report's section with the basis of the verdict: claims, measures, differences between the runs."""
    parts = [_claims(group) for group in verdict.groups]
    parts += [element("h3", "Measures: what truly happened, and what the robot believed"), _measures(runs)]
    if len(runs) > 1:
        head = ("difference", "unit", *(run.label for run in runs))
        rows = differences(runs)
        parts.append(element("h3", "Differences"))
        same = element("p", "Nothing in experiments, FMUs and versions.")
        parts.append(table(head, rows, "differences between the runs") if rows else same)
    return join_markup(parts)


def events(run: ReportRun) -> Markup:
    """Return the report's table of events, phases of tasks folded; a click on a time moves the player."""
    rows = {
        debug: [
            (time_button(event.time), event.level, event.name, event.text)
            for event in run.recording.events
            if (event.level == "debug") == debug
        ]
        for debug in (False, True)
    }
    head = ("at", "level", "of", "what")
    parts = [table(head, rows[False], f"events of {run.label}") if rows[False] else element("p", "None.")]
    if rows[True]:
        inside = table(head, rows[True], f"phases of {run.label}")
        parts.append(element("details", element("summary", f"{len(rows[True])} phases"), inside))
    return join_markup(parts)


def _claims(group: RunGroup) -> Markup:
    held, judged = tally(group.findings)
    words = standing_text(group.findings, group.name)
    rows = [_claim(finding) for finding in group.findings]
    head = ("claim", "verdict", "measured", "expected", "why")
    summary = element("summary", f"{group.title}: {words}")
    unfolded = {"open": ""} if held < judged or len(rows) <= MAX_OPEN_CLAIMS else {}
    return element("details", summary, table(head, rows, group.title), **unfolded)


def _claim(finding: ClaimFinding) -> tuple[str, ...]:
    claim = finding.claim
    text, look = VERDICT_MARKS[finding.verdict]
    place = f"Fig. {claim.figure}: " if claim.figure[0].isdigit() else ""
    quoted = element("small", f"{place}{claim.quote}")
    expected = f"{claim.bounds_text} {claim.unit}".rstrip() if claim.bounds_text else ""
    return (
        join_markup([claim.text, quoted]),
        element("span", text, class_=look),
        finding.measured_text,
        expected,
        finding.reason or claim.source,
    )


def _measures(runs: Sequence[ReportRun]) -> Markup:
    found = [{(m.text, m.unit): m for m in run.measures} for run in runs]
    lines = dict.fromkeys(key for one in found for key in one)
    if len(runs) == 1:
        only = [(text, _number(m), number_text(m.believed), unit) for (text, unit), m in found[0].items()]
        return table(("measure", "true", "believed", "unit"), only, "measures")
    rows = [(text, unit, *(_measure(one.get((text, unit))) for one in found)) for text, unit in lines]
    return table(("measure", "unit", *(run.label for run in runs)), rows, "measures")


def _measure(measure: RunMeasure | None) -> Markup:
    if measure is None:
        return Markup("-")
    believed = [] if math.isnan(measure.believed) else [element("small", f"believed {number_text(measure.believed)}")]
    return join_markup([_number(measure), *believed])


def _number(measure: RunMeasure) -> str:
    """Format the true value of a measure, or the reason why it is missing."""
    return f"none ({measure.reason})" if math.isnan(measure.true) and measure.reason else number_text(measure.true)


def _folded_parameters(run: ReportRun) -> Markup:
    robot = element("p", f"The robot has {robot_values_text(robot_values(run.values, run.origins))}.")
    summary = element("summary", f"{sum(1 for _ in flatten(run.values))} values with unit and source")
    return join_markup([robot, element("details", summary, parameters(run))])


def _of_each(runs: Sequence[ReportRun], write: Callable[[ReportRun], Markup]) -> Markup:
    """Return the HTML that `write` makes for one run, or for several runs each under its label."""
    if len(runs) == 1:
        return write(runs[0])
    return join_markup([part for run in runs for part in (element("h3", run.label), write(run))])


def write_report(
    runs: Sequence[Path],
    out: Path | None = None,
    budget: bool = False,
    say: Say = ignore_progress,
) -> Answer:
    """Write the report page on the runs at the given paths (at least one; see `report_runs`), as one HTML file.

    `out` is report.html in the recording's folder, or in results/report for several runs, if None. With `budget`, each
    experiment is run again without its imperfections, one after the other, for its accuracy budget.
    """
    shown = report_runs(runs)
    path = out or (shown[0].recording.path.parent if len(shown) == 1 else COMPARISON_FOLDER) / REPORT_FILE
    if any(is_system(run.recording) for run in shown):
        if budget:
            raise InputRefused(f"{runs[0]}: records a system of FMUs, which has no force error; leave --budget out")
        headline, found = system_sections(shown)
        title = shown[0].label if len(shown) == 1 else f"{len(shown)} runs of systems"
        html = plain_page(title, " | ".join(run.label for run in shown), found)
    elif any(is_session(run.recording) for run in shown):
        require_sessions(shown)
        if budget:
            raise InputRefused(f"{runs[0]}: records a session, whose true force is not known; leave --budget out")
        html, headline = session_page(shown)
    else:
        html, headline = report_page(shown, [_budget(run, say) for run in shown] if budget else ())
    make_folder(path.parent)
    write_text(path, html)
    page = relative_path(path)
    lines = [*wrap_text(headline, later=2, whole=True), f"  page  {page}"]
    return Answer("\n".join(lines), {"headline": headline, "page": str(page)})


def report_page(runs: Sequence[ReportRun], budgets: Sequence[budgeting.Budget] = ()) -> tuple[str, str]:
    """Return (HTML, headline) of the report, equal for equal inputs; `budgets` is empty or has one budget per run."""
    judged = verdict(runs)
    with picture(runs, judged) as drawn:
        data, factor = _data(runs)
        parts = sections(runs, judged, drawn(), budgets)
    title = runs[0].title if len(runs) == 1 else f"{len(runs)} runs compared"
    return _player_page(runs, title, verdict_section(runs, judged), parts, data, factor), judged.headline


def session_page(runs: Sequence[ReportRun]) -> tuple[str, str]:
    """Return (HTML, headline) of the report on recorded sessions with a robot."""
    judged = session_verdict(runs)
    data, factor = _data(runs, SESSION_PANELS, "estimator", "plant")
    found = [
        ("followed", "How well it followed", residuals),
        ("alarms", "Alarms", alarms),
        ("gaps", "Gaps", gaps),
        ("punctuality", "Punctuality", punctuality),
        ("events", "Events", events),
        ("parameters", "Parameters", _folded_parameters),
        ("origin", "What was followed", origin),
    ]
    parts = [(key, title, _of_each(runs, write)) for key, title, write in found]
    title = runs[0].title if len(runs) == 1 else f"{len(runs)} sessions"
    first = verdict_section(runs, judged, _of_each(runs, boxes))
    return _player_page(runs, title, first, parts, data, factor, SESSION_KEY), judged.headline


def _player_page(
    runs: Sequence[ReportRun],
    title: str,
    first: Markup,
    parts: Sequence[Section],
    data: dict[str, Any],
    factor: int,
    key: Markup = FORCE_KEY,
) -> str:
    """Return the HTML of a page with plots and player, `first` before these, and `parts` after these."""
    links = [("verdict", "Verdict"), ("replay", "Replay"), *((key, text) for key, text, _ in parts)]
    script = "\n".join((PAGE_ASSETS / f"{name}.js").read_text(encoding="utf-8") for name in PAGE_SCRIPTS)
    more = {"verdict": first, "key": key, "data": _json(data), "script": script}
    more |= {"remark": _remark(data["scenes"], factor), "chooser": _chooser(runs, data["scenes"])}
    return _fill_template("page.html", title, " | ".join(run.label for run in runs), parts, links, **more)


def _data(
    runs: Sequence[ReportRun], shown: Sequence[Panel] | None = None, robot: str = "plant", model: str = ""
) -> tuple[dict[str, Any], int]:
    """Return the samples and other data for the page's scripts, and the thinning factor of the samples."""
    blocks = [DataBlock() for _ in runs]
    # in threads: hashing and compression release the GIL
    with ThreadPoolExecutor(2) as pool:
        pool.map(lambda run: run.sha256, runs)
        panels, factor = curves(runs, blocks, shown)
        scenes = [scene(run, block, robot=robot, model=model) for run, block in zip(runs, blocks, strict=True)]
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


def _budget(run: ReportRun, say: Say) -> budgeting.Budget:
    experiment = recorded_experiment(run.recording.metadata, run.recording.path)
    return budgeting.accuracy_budget(experiment, lambda what, share=None: say(f"{run.label}: {what}", share))


def _remark(scenes: Sequence[dict[str, Any] | None], factor: int) -> Markup:
    notes = []
    if not any(scenes):
        notes.append("The recording has no joint angles, so there is no player.")
    if factor > 1:
        notes.append(f"The recording is long: the curves show the extremes of every {2 * factor} samples only.")
    return join_markup([element("p", text) for text in notes])


def _chooser(runs: Sequence[ReportRun], scenes: Sequence[dict[str, Any] | None]) -> Markup:
    """Return the HTML menu that selects the run in the player; empty for one run."""
    if len(runs) == 1:
        return Markup()
    options = [
        element("option", run.label, value=str(number))
        for number, (run, its) in enumerate(zip(runs, scenes, strict=True))
        if its
    ]
    return element("label", "Run ", element("select", *options, id="run"))


def _json(data: object) -> str:
    """Encode data as JSON for a page's script element; no text in it can end the element."""
    return json.dumps(to_dict(data), ensure_ascii=False, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def plain_page(
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    links: Sequence[tuple[str, str]] | None = None,
    made_of: str = "",
) -> str:
    """Return the HTML of a page without plots, player and scripts; `made_of` follows "Made by twin VERSION" below.

    Links in the head are (key, text); None for one to each section.
    """
    links = [(key, name) for key, name, _ in sections] if links is None else links
    return _fill_template("plain.html", title, subtitle, sections, links, made_of=made_of)


def _fill_template(
    file: str, title: str, subtitle: str, sections: Sequence[Section], links: Sequence[tuple[str, str]], **more: str
) -> str:
    return Template((PAGE_ASSETS / file).read_text(encoding="utf-8")).substitute(
        title=join_markup([title]),
        subtitle=element("p", subtitle),
        style=(PAGE_ASSETS / "page.css").read_text(encoding="utf-8"),
        dark=dark_filter(),
        contents=join_markup([element("a", text, href=f"#{key}") for key, text in links]),
        sections=join_markup([section(*one) for one in sections]),
        version=join_markup([version("twin")]),
        **more,
    )
