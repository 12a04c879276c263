"""What experiments are by now, beside what they were when they ran."""

import json
from collections.abc import Sequence
from pathlib import Path

from twin.errors import InputRefused, TwinError
from twin.experiment.difference import differing, experiment_facts, recorded_facts
from twin.experiment.named import experiment_file
from twin.experiment.recorded import recorded_name
from twin.runs.assembly.declared import DECLARED
from twin.runs.assembly.drives import fmus
from twin.runs.assembly.load import load_experiment
from twin.runs.provenance import named_files
from twin.studies.results.kept import KeptRun


class ExperimentsNow:
    """Experiments as their files say them now; each is read once."""

    def __init__(self) -> None:
        self._facts: dict[tuple[str, ...], dict[str, str]] = {}

    def differences(self, run: KeptRun) -> dict[str, tuple[str, str]]:
        """What of `run` would be otherwise if it were run again with the same options: (then, now) by key.

        A controller of another make leaves no gains in a recording, so there nothing can differ.

        Raises:
            TwinError: the run says of no experiment, or there is none of that name any more, or a mistake in it.
        """
        then = recorded_facts(DECLARED, run.metadata, run.recording)
        now = self._of(recorded_name(run.metadata, run.recording), run.typed)
        if "controller" in run.metadata.get("substituted", {}):
            now = {key: value for key, value in now.items() if key in then or not key.startswith("controller.")}
        return {key: (values[0], values[1]) for key, values in differing([then, now]).items()}

    def _of(self, name: str, typed: Sequence[str]) -> dict[str, str]:
        known = (name, *typed)
        if known not in self._facts:
            said: dict[str, list[str]] = {}
            for option, value in zip(typed[::2], typed[1::2], strict=True):
                said.setdefault(option, []).append(value)
            drive, body = (said.get(option, [None])[0] for option in ("--drive", "--body"))
            file = experiment_file(name)
            # a name, as twin records it, and not whatever lies in the current folder
            if file.name != f"{name}.toml":
                raise InputRefused(f"{name}: the recording calls its experiment so, which is no name of one")
            if body and Path(body).name != body:
                raise InputRefused(f"its body {body} is named by a path, and only a name is looked up")
            experiment = load_experiment(file, said.get("--set", ()), drive, body)
            hashes = {fmu.path.name: fmu.sha256 for one in experiment.drives for fmu in fmus(one).values()}
            # through JSON, as what is recorded
            self._facts[known] = experiment_facts(json.loads(json.dumps(named_files(experiment.values))), hashes)
        return self._facts[known]


def told_differences(run: KeptRun, now: ExperimentsNow) -> tuple[dict[str, tuple[str, str]], str]:
    """The differences of `run`, and why nobody can tell them; one of the two is empty."""
    if "system" in run.metadata:
        return {}, "a system of FMUs, without an experiment"
    if "experiment" not in run.metadata:
        return {}, "does not say what it was made of"
    try:
        return now.differences(run), ""
    except TwinError as problem:
        return {}, str(problem).splitlines()[0]
