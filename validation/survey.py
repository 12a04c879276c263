"""`python -m validation.survey FOLDER`: try every FMU below a folder, and write the results as data.

Each is tried in a process of its own: one that crashes, hangs or grows costs itself only. Of the .json of an earlier
survey only the page is made again, with `--page FILE`; systems below `--systems FOLDER` are tried, too.
"""

import argparse
import platform
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import Any

from twin.kernel.archive import entries, read_entry, sha256
from twin.kernel.atomic_write import make_folder, write_json, write_text
from twin.kernel.cache_folder import cache_folder
from twin.kernel.errors import InputRefused, TwinError, escape_controls
from twin.kernel.files import parse_xml, read_json, read_toml
from twin.kernel.fmi.description import DESCRIPTION_FILE, MAX_DESCRIPTION_SIZE
from twin.kernel.fmi.unpacked import CONTENT_FOLDER, UNPACKED_FOLDER
from twin.kernel.process.guard import JobFailure, JobLoadFailure, run_guarded
from twin.kernel.process.job import JobLimits
from twin.kernel.process.reporter import Reporter
from twin.robot.assembly.drives import plan_drive
from twin.robot.experiment.drive_files import load_drive
from twin.studies.reference.outcome import (
    BAD_OUTCOMES,
    TOLERANCE_NOTE,
    ReferenceOutcome,
    Trial,
    outcome_of,
    reference_files,
    references,
)
from twin.studies.result import count_text, labelled_lines, markdown
from validation.systems import system_row, systems_below

DOCS = Path(__file__).parents[1] / "docs"
JOB = "validation.survey:tried"
DEFAULT = "default experiment"
POINTER = b"version https://git-lfs"
ABSOLUTE = re.compile(r"(?:file:/*|(?<![\w./:-])/)(?:[\w.-]+/)+")
LONGEST = 400
"""Characters of a sentence: what an FMU says in its own words may be long."""
MOST_FMUS = 5_000
MEMORY = 2e9
"""Bytes that one FMU may take."""
OUTCOME_MEANINGS = {
    "agrees": "it reproduced the results",
    "differs": "it deviated from the results",
    "ran": "it ran to the end, without results to compare",
    "refused": "something was refused before it ran",
    "failed": "it could not be initialised, or returned an error, NaN or infinity",
    "lost": "its process crashed, hung or outgrew its limits",
}
KINDS = {
    "CoSimulation": "co-simulation",
    "ModelExchange": "model exchange",
    "ScheduledExecution": "scheduled execution",
}

HEAD = """# Which FMUs work

What came of the FMUs that were tried, each by itself and in a process of its own: the reference experiments that came
with it ([FMI-LS-REF](drives_reference.md#what-came-with-an-fmu), or the files of the FMI Cross-Check beside it), and
without such its default experiment, with its own start values and no inputs. Whether it is a drive is another question:
*drive* says that names, units and causalities fit the [contract](drives_reference.md#the-contract) as they are; most
others need a mapping.

This page is made from `docs/compatibility.json`, which `make survey` writes. The FMUs belong to their makers and are no
part of this project. An FMU runs with the rights of the user who starts it: survey only FMUs that you trust.
"""


OF_SYSTEMS = ("system_sources", "systems")
SYSTEMS_HEAD = """## Systems

Systems of others, run by `twin cosim` as their files say, small offences let through (`--lenient`); one that states no
step or end for 1 s in steps of 10 ms. *agrees*: with the numbers that its test expects, within 1 % of each signal.
"""


def survey(
    place: Path, sources: Path | None, data: Path, page: Path | None, wall: float, systems: Path | None = None
) -> dict[str, Any]:
    """Try every FMU below a folder, each in a process of its own, and write down what came out.

    Args:
        place: folder; or the data of an earlier survey, of which only the page is made again.
        sources: TOML with a table for each folder in `place`: `from`, where its FMUs are from.
        data: JSON that is written.
        page: Markdown that is written; None: none.
        wall: longest time that an FMU or a system may take (s).
        systems: folder of systems, as `place`; None: none are tried, and what `data` has of some stays.

    Returns:
        The data.

    Raises:
        InputRefused: no such folder, no FMU in it, a folder of which the sources say nothing.
        NotWritten: the disk refuses.
    """
    if place.suffix == ".json":
        facts = _earlier(place)
    else:
        facts = _surveyed(place, sources, wall)
        if data.exists():
            facts |= {key: value for key, value in _earlier(data).items() if key in OF_SYSTEMS}
    if systems is not None:
        facts |= _surveyed_systems(systems, sources, wall)
    if systems is not None or place.suffix != ".json":
        write_json(make_folder(data.parent) / data.name, facts)
    if page is not None:
        write_text(make_folder(page.parent) / page.name, page_text(facts))
    return facts


def _earlier(data: Path) -> dict[str, Any]:
    facts = read_json(data)
    if not isinstance(facts, dict) or not isinstance(facts.get("fmus"), list):
        raise InputRefused(f"{data}: no data of a survey; expected what `python -m validation.survey` wrote")
    return facts


def _grouped(place: Path, files: Sequence[Path], sources: Path | None, what: str) -> tuple[dict[Path, str], Any]:
    """The folder in `place` of each file, and what `sources` says of these folders."""
    if not 0 < len(files) <= MOST_FMUS:
        raise InputRefused(f"{place}: {len(files)} {what} below it; expected 1 to {MOST_FMUS}")
    described = read_toml(sources) if sources else {}
    groups = {file: file.relative_to(place).parts[0] if file.parent != place else "" for file in files}
    if sources and (silent := sorted(set(groups.values()) - set(described))):
        raise InputRefused(f"{sources}: nothing of {', '.join(silent)}; expected a table for each folder in {place}")
    return groups, {name: described.get(name, {}).get("from", "") for name in sorted(set(groups.values()))}


def _surveyed_systems(place: Path, sources: Path | None, wall: float) -> dict[str, Any]:
    """What came of the systems below `place`; the same one in several places is one."""
    rows: dict[str, dict[str, Any]] = {}
    with TemporaryDirectory() as scratch:
        found = dict(systems_below(place, Path(scratch)))
        groups, origins = _grouped(place, [*found], sources, "systems")
        for number, (name, file) in enumerate(found.items(), 1):
            if (digest := sha256(name)) not in rows:
                print(f"{number} of {len(found)}: {name.relative_to(place)}", flush=True)
                inside = name.relative_to(place / groups[name]).as_posix()
                row = system_row(inside, file, JobLimits(wall=wall, memory=MEMORY))
                row["detail"] = _without_paths(row["detail"], file)
                rows[digest] = {"source": groups[name], **row, "sha256": digest}
    return {"system_sources": origins, "systems": list(rows.values())}


def _surveyed(place: Path, sources: Path | None, wall: float) -> dict[str, Any]:
    if not place.is_dir():
        raise InputRefused(f"{place}: no such folder; expected one with FMUs, or the .json of an earlier survey")
    files = sorted(file for file in place.rglob("*.fmu") if file.is_file())
    groups, origins = _grouped(place, files, sources, "FMUs")
    rows: dict[str, dict[str, Any]] = {}
    for number, file in enumerate(files, 1):
        # the same file in several places is one FMU
        if (digest := sha256(file)) not in rows:
            print(f"{number} of {len(files)}: {file.name}", flush=True)
            rows[digest] = {"source": groups[file], **row(file, digest, JobLimits(wall=wall, memory=MEMORY))}
    where = f"{platform.machine()} {platform.system()}"
    return {"platform": where, "sources": origins, "fmus": list(rows.values())}


def row(file: Path, digest: str, limits: JobLimits) -> dict[str, Any]:
    """What the FMU `file` is and what came of trying it, in a process that may crash or hang.

    Keys: file, sha256; model, tool, fmi, kinds, platforms as of `Stated`, where it can be read; drive, whether it fits
    the contract as it is; tried; word, one of `OUTCOME_MEANINGS`; detail, one sentence.

    Raises:
        InputRefused: the disk refuses to read it.
    """
    known: dict[str, Any] = {"file": file.name, "sha256": digest, "drive": False, "tried": "nothing"}
    with file.open("rb") as stream:
        if stream.read(len(POINTER)) == POINTER:
            return known | {"word": "refused", "detail": "a Git LFS pointer stands in its place"}
    try:
        found = run_guarded(JOB, {"file": str(file)}, limits, known.update)
    except (JobFailure, JobLoadFailure) as failure:
        found = {"word": "lost", "detail": str(failure)}
    except TwinError as refusal:
        found = {"word": "refused", "detail": str(refusal)}
    known |= found
    return known | {"detail": _without_paths(known["detail"], file)}


def tried(reporter: Reporter, file: str) -> dict[str, Any]:
    """What came of trying the FMU `file`; a job of the guard.

    Notes what it says of itself, then what is tried.

    Raises:
        InputRefused: it is no FMU.
    """
    path = Path(file)
    reporter.note(**asdict(stated(path)))
    try:
        plan_drive(load_drive(file, path.parent))
        reporter.note(drive=True)
    except InputRefused:
        pass
    came = len(reference_files(path).trials)
    reporter.note(tried=count_text(came, "experiment") + " that came with it" if came else DEFAULT)
    found = references(path, apart=False)
    if not (came and found):
        return _facts(outcome_of(path, Trial(DEFAULT)))
    order = (*BAD_OUTCOMES, "agrees", "ran")
    return _facts(min(found.outcomes, key=lambda outcome: order.index(outcome.word)))


def _facts(outcome: ReferenceOutcome) -> dict[str, Any]:
    return {"word": outcome.word, "detail": outcome.detail}


def _without_paths(sentence: str, file: Path) -> str:
    """A sentence on one line that tells nothing of this machine."""
    cache = re.escape(f"{cache_folder(UNPACKED_FOLDER)}/")
    sentence = re.sub(f"{cache}[0-9a-f]{{64}}/{CONTENT_FOLDER}/?", "", sentence).replace(f"{file.parent}/", "")
    # what a file names on the machine of who wrote it
    sentence = ABSOLUTE.sub("", sentence)
    sentence = escape_controls(" ".join(sentence.split()))
    return sentence if len(sentence) <= LONGEST else sentence[: LONGEST - 3] + "..."


@dataclass(frozen=True)
class Stated:
    """What stands in modelDescription.xml; "" where it says nothing.

    Attributes:
        model: its name.
        tool: that made it, with its version.
        fmi: version of the standard.
        kinds: values of `KINDS`.
        platforms: folders of binaries.
    """

    model: str
    tool: str
    fmi: str
    kinds: tuple[str, ...]
    platforms: tuple[str, ...]


def stated(file: Path) -> Stated:
    """What the FMU `file` says of itself.

    Raises:
        InputRefused: no sound archive, or no description in it that is XML.
    """
    names = entries(file)
    if DESCRIPTION_FILE not in names:
        raise InputRefused(f"{file}: no {DESCRIPTION_FILE} inside; this is not an FMU")
    root = parse_xml(read_entry(file, DESCRIPTION_FILE, MAX_DESCRIPTION_SIZE), f"{file}: {DESCRIPTION_FILE}")
    version = root.get("fmiVersion", "")
    kinds = tuple(kind for tag, kind in KINDS.items() if root.find(tag) is not None)
    if version.startswith("1"):
        # FMI 1.0 tells co-simulation by the element that says how it is implemented
        kinds = (KINDS["ModelExchange"] if root.find("Implementation") is None else KINDS["CoSimulation"],)
    folders = {PurePosixPath(name).parts[1] for name in names if name.startswith("binaries/") and name.count("/") > 1}
    tool = " ".join(root.get("generationTool", "").split())
    return Stated(root.get("modelName", ""), tool, version, kinds, tuple(sorted(folders)))


def page_text(facts: Mapping[str, Any]) -> str:
    """The page, Markdown."""
    count = count_text(len(facts["fmus"]), "FMU")
    tried = f"Tried on {facts['platform']}: {count}, each with the beginning of its SHA-256."
    lines = [HEAD, f"{tried} Held to results within {TOLERANCE_NOTE}.", ""]
    words = Counter(row["word"] for row in facts["fmus"])
    lines += [
        markdown(
            ["word", "FMUs", "meaning"], ([word, str(words[word]), OUTCOME_MEANINGS[word]] for word in OUTCOME_MEANINGS)
        ),
        "",
    ]
    for source, origin in facts["sources"].items():
        rows = [row for row in facts["fmus"] if row["source"] == source]
        lines += [f"## {source or 'FMUs'}", "", *([f"{origin}", ""] if origin else [])]
        lines += [markdown(["FMU", "made with", "FMI", "tried", "came out", "in a sentence"], map(_cells, rows)), ""]
    return "\n".join([*lines, *_systems_text(facts)])


def _systems_text(facts: Mapping[str, Any]) -> Iterator[str]:
    """The part of the page that is about systems; nothing if none were tried."""
    systems = facts.get("systems", [])
    if not systems:
        return
    words = Counter(row["word"] for row in systems)
    yield f"{SYSTEMS_HEAD}\n{count_text(len(systems), 'system')} of others, each with the beginning of its SHA-256.\n"
    yield markdown(["word", "systems"], ([word, str(words[word])] for word in OUTCOME_MEANINGS if words[word]))
    for source, origin in facts["system_sources"].items():
        yield f"\n### Systems of {source}\n\n{origin}\n"
        rows = [row for row in systems if row["source"] == source]
        cells = ([_plain(text) for text in _system_cells(row)] for row in rows)
        yield markdown(["system", "form", "FMUs", "tried", "came out", "in a sentence"], cells)
    yield ""


def _system_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    return (
        f"{row['file']} ({row['sha256'][:8]})",
        row["form"],
        str(row["parts"]),
        row["tried"],
        row["word"],
        row["detail"],
    )


def survey_text(facts: Mapping[str, Any]) -> str:
    """How many came out how, then those that did not run."""
    words = Counter(row["word"] for row in facts["fmus"])
    lines = [
        f"{count_text(len(facts['fmus']), 'FMU')}: "
        + ", ".join(f"{words[word]} {word}" for word in OUTCOME_MEANINGS if words[word])
    ]
    for row in facts["fmus"]:
        if row["word"] not in ("agrees", "ran"):
            lines += labelled_lines(
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


def main(arguments: Sequence[str]) -> int:
    """The exit code: 0 done whatever came out, 2 refused."""
    parser = argparse.ArgumentParser(prog="python -m validation.survey", description=__doc__)
    parser.add_argument("place", metavar="FOLDER", type=Path, help="with FMUs, or the .json of an earlier survey")
    parser.add_argument("--sources", metavar="FILE", type=Path, help="TOML: for each folder in FOLDER a table, `from`")
    parser.add_argument("--data", metavar="FILE", type=Path, default=DOCS / "compatibility.json", help="JSON to write")
    parser.add_argument("--page", metavar="FILE", type=Path, help="page to write, too; the site makes its own")
    parser.add_argument("--systems", metavar="FOLDER", type=Path, help="with systems, which are tried, too")
    parser.add_argument("--limit-wall", metavar="S", type=float, default=60.0, help="longest time of one FMU")
    asked = parser.parse_args(arguments)
    try:
        facts = survey(asked.place, asked.sources, asked.data, asked.page, asked.limit_wall, asked.systems)
    except TwinError as refusal:
        print(refusal, file=sys.stderr)
        return 2
    print(survey_text(facts))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
