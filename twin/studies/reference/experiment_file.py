"""Experiments as files describe them: parameters, stimuli and results by name, and how to run.

Two formats: the experiments (.exp) that FMI-LS-REF described until they became MA-HS-Experiments, and the options
(NAME_ref.opt) of the FMI Cross-Check, https://github.com/modelica/fmi-cross-check.
"""

import re
from dataclasses import dataclass
from typing import Any

from twin.cosim.ssp.elements import finite
from twin.errors import InputRefused
from twin.files import xml_of

MIMES = ("application/x-ma-hs-experiments", "application/x-ma-ls-experiments")
MOST_EXPERIMENTS = 100
OPTION = re.compile(r"\s*\"?(\w+)\"?\s*[,;=:\s]\s*\"?([^\s\";,]+)")
TIMES = {"startTime": "start", "stopTime": "stop", "stepSize": "step", "tolerance": "tolerance"}
OPTIONS = {"starttime": "start", "stoptime": "stop", "stepsize": "step", "reltol": "tolerance"}


@dataclass(frozen=True)
class Described:
    """An experiment.

    Attributes:
        name: of the experiment.
        parameters, stimuli, results: (URI, MIME type) of each file; None: not given.
        start, stop, step: s; None: not given, the FMU's own.
        tolerance: relative, of the FMU's solver; None likewise.
    """

    name: str
    parameters: tuple[str, str] | None = None
    stimuli: tuple[str, str] | None = None
    results: tuple[str, str] | None = None
    start: float | None = None
    stop: float | None = None
    step: float | None = None
    tolerance: float | None = None


FILES = {"Parameters": "application/x-ssp-parameter-set", "Stimuli": "text/csv", "References": "text/csv"}
"""Element -> the type of its file where it states none."""


def experiments_of(content: bytes, where: str) -> list[Described]:
    """The experiments in an .exp file.

    Raises:
        InputRefused: no such file, or one of its numbers is none.
    """
    root = xml_of(content, where)
    if root.tag != "Experiments":
        raise InputRefused(f"{where}: <{root.tag}>; expected <Experiments>")
    listed = root.findall("Experiment")
    if len(listed) > MOST_EXPERIMENTS:
        raise InputRefused(f"{where}: {len(listed)} experiments; expected at most {MOST_EXPERIMENTS}")
    found = []
    for element in listed:
        given: dict[str, Any] = {"name": element.get("name", "")}
        for tag, key in zip(FILES, ("parameters", "stimuli", "results"), strict=True):
            if (file := element.find(tag)) is not None:
                given[key] = (file.get("source", ""), file.get("type", FILES[tag]))
        for attribute, key in TIMES.items():
            if attribute in element.attrib:
                given[key] = finite(element.attrib[attribute], f"{where}: {given['name']}: {attribute}")
        found.append(Described(**given))
    return found


def options_of(text: str, where: str) -> dict[str, float]:
    """Keys `start`, `stop`, `step`, `tolerance` of `Described` that the lines of a _ref.opt give.

    A step of 0 says that the exporting tool chose its steps itself, and is left out.

    Raises:
        InputRefused: one of these is no number.
    """
    given = {}
    for line in text.splitlines():
        if (found := OPTION.match(line)) and (key := OPTIONS.get(found[1].lower())):
            given[key] = finite(found[2], f"{where}: {found[1]}")
    return {key: value for key, value in given.items() if value > 0.0 or key == "start"}
