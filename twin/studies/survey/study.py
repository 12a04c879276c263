"""A survey: every FMU below a folder is tried, and what came out is data, from which a page is made."""

import platform
from pathlib import Path
from typing import Any

from twin.archive import sha256
from twin.errors import InputRefused
from twin.files import read_json, read_toml
from twin.runs.guard.limits import Limits
from twin.studies.answer import Answer
from twin.studies.steps import Say
from twin.studies.survey.fmu import row
from twin.studies.survey.page import page_text, survey_text
from twin.writing import made_folder, write_json, write_text

MOST_FMUS = 5_000
MEMORY = 2e9
"""Bytes that one FMU may take."""


def survey(place: Path, sources: Path | None, data: Path, page: Path | None, wall: float, say: Say) -> Answer:
    """Try every FMU below a folder, each in a process of its own, and write down what came out.

    Args:
        place: folder; or the data of an earlier survey, of which only the page is made again.
        sources: TOML with a table for each folder in `place`: `from`, where its FMUs are from.
        data: JSON that is written.
        page: Markdown that is written; None: none.
        wall: longest time that an FMU may take (s).
        say: told which one is being tried.

    Raises:
        InputRefused: no such folder, no FMU in it, a folder of which the sources say nothing.
        NotWritten: the disk refuses.
    """
    if place.suffix == ".json":
        facts = read_json(place)
        if not isinstance(facts, dict) or not isinstance(facts.get("fmus"), list):
            raise InputRefused(f"{place}: no data of a survey; expected what `twin drive survey` wrote")
    else:
        facts = _surveyed(place, sources, wall, say)
        write_json(made_folder(data.parent) / data.name, facts)
    if page is not None:
        write_text(made_folder(page.parent) / page.name, page_text(facts))
    written = [str(file) for file in (data if place.suffix != ".json" else None, page) if file]
    return Answer("\n".join([survey_text(facts), *(f"  written  {file}" for file in written)]), facts)


def _surveyed(place: Path, sources: Path | None, wall: float, say: Say) -> dict[str, Any]:
    if not place.is_dir():
        raise InputRefused(f"{place}: no such folder; expected one with FMUs, or the .json of an earlier survey")
    files = sorted(file for file in place.rglob("*.fmu") if file.is_file())
    if not 0 < len(files) <= MOST_FMUS:
        raise InputRefused(f"{place}: {len(files)} FMUs below it; expected 1 to {MOST_FMUS}")
    told = read_toml(sources) if sources else {}
    groups = {file: file.relative_to(place).parts[0] if file.parent != place else "" for file in files}
    if sources and (silent := sorted(set(groups.values()) - set(told))):
        raise InputRefused(f"{sources}: nothing of {', '.join(silent)}; expected a table for each folder in {place}")
    rows: dict[str, dict[str, Any]] = {}
    for number, file in enumerate(files, 1):
        # the same file in several places is one FMU
        if (digest := sha256(file)) not in rows:
            say(f"{number} of {len(files)}: {file.name}", (number - 1) / len(files))
            rows[digest] = {"source": groups[file], **row(file, digest, Limits(wall=wall, memory=MEMORY))}
    origins = {name: told.get(name, {}).get("from", "") for name in sorted(set(groups.values()))}
    where = f"{platform.machine()} {platform.system()}"
    return {"platform": where, "sources": origins, "fmus": list(rows.values())}
