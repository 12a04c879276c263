"""A part of another make, from what names it to a verdict."""

from collections.abc import Callable, Sequence
from pathlib import Path

from twin.errors import InputRefused
from twin.runs.assembly.load import load_experiment
from twin.runs.assembly.roles import CONTRACTS, other_part
from twin.runs.trace import run_in_memory
from twin.studies.answer import Answer
from twin.studies.component.check import checked_part
from twin.studies.component.text import checked_text, component_facts, contracts_text


def check(role: str, part: str | None, experiment: Path, settings: Sequence[str], say: Callable[[str], None]) -> Answer:
    """Whether a part of another make can take its place in the robot, called with what twin's own gets.

    Exit code 1: it cannot.

    Args:
        role: which part of the robot, one of `CONTRACTS`.
        part: an FMU, a mapping, a folder with one, or FILE:CLASS; None: the one that the experiment names.
        experiment: its file or name; a run of it with twin's own part, or with the one it names, makes the inputs.
        settings: laid over the experiment that has the part; mapping and parameters go here.
        say: told what is being done.

    Raises:
        InputRefused: the part or the experiment cannot be used.
        ComponentFailed: another component failed in the run.
    """
    if role not in CONTRACTS:
        raise InputRefused(f"{role}: no part that may be of another make; these are {', '.join(CONTRACTS)}")
    named = [] if part is None else [f"{role}.{'python' if '.py:' in part else 'fmu'}={_absolute(part)!r}"]
    other = load_experiment(experiment, [*named, *settings])
    if role not in other.stand_ins:
        raise InputRefused(f"{other.name}: its {role} is twin's own; name an FMU, or FILE:CLASS")
    found = other_part(role, other.stand_ins[role])
    say(f"running {other.name}")
    # settings of the part mean nothing to twin's own
    rest = [text for text in settings if not text.startswith(f"{role}.")]
    run = run_in_memory(load_experiment(experiment, rest))
    ticks = {"monitor": other.monitor_ticks, "scale": other.scale_ticks, "body": 1}.get(role, other.controller_ticks)
    done = checked_part(found, other, ticks, run, part is not None, say)
    return Answer(checked_text(done), component_facts(done), 0 if done.good else 1)


def contracts(say: Callable[[str], None]) -> Answer:
    """The ports of every part that may be of another make."""
    facts = {
        role: {
            side: [
                {
                    "name": port.name, "size": port.size, "unit": port.unit, "meaning": port.meaning,
                    "required": side == "outputs" and port.name in contract.required,
                }
                for port in ports
            ]
            for side, ports in (("inputs", contract.inputs), ("outputs", contract.outputs))
        }
        for role, contract in CONTRACTS.items()
    }  # fmt: skip
    return Answer(contracts_text(), facts)


def _absolute(part: str) -> str:
    """`part` as seen from the current folder, if it is there: an experiment looks beside itself."""
    file, colon, name = part.rpartition(":") if ".py:" in part else (part, "", "")
    return f"{Path(file).absolute()}{colon}{name}" if Path(file).exists() else part
