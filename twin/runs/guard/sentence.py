"""The sentence about a job whose process ended without a result."""

import signal

from twin.runs.guard.account import Account, Participant, Stepped
from twin.runs.guard.black_box import BlackBox

LONGEST_QUOTE = 200
_REMEDY = "{file} is not fit to be used: tell its maker, with these facts; `--isolate none` runs it under a debugger."


def manner(status: int) -> str:
    """How a process ended by itself, as the verb phrase of a sentence.

    Args:
        status: exit status, negative for a signal.
    """
    if status >= 0:
        return f"ended the process with exit({status})"
    name = signal.Signals(-status).name
    if -status == signal.SIGKILL:
        return f"was killed from outside ({name}; the machine may have run out of memory)"
    if -status == signal.SIGABRT:
        return f"aborted the process ({name})"
    return f"crashed ({name}, {(signal.strsignal(-status) or 'unknown').lower()})"


def failure_sentence(
    account: Account, box: BlackBox, manner: str, remedy: str | None, printed: str, culprit: str | None = None
) -> str:
    """Who ended the job: file, instance, function, simulated time, last inputs, remedy.

    Args:
        account, box: what is known.
        manner: verb phrase, see `manner`.
        remedy: a sentence; None: the one for an FMU that is broken.
        printed: what the job wrote at last.
        culprit: the component to blame; None: the one at work.
    """
    participant = _named(account.stepped, culprit) if culprit else account.stepping(box)
    if (call := box.call()) and not culprit:
        _, file, instance, function = call
        who, where = f"{file} ({instance})", f"in {function}, {_when(account, box)}"
        participant = _named(account.stepped, instance)
    elif account.stepped and participant:
        file = participant.label
        who = f"{file} ({participant.name})" if file else participant.name
        where = ("at " if participant.sampled else "in the step from ") + _time(account.stepped, box)
        where += f", in {participant.function} or the set and get calls around it" if participant.function else ""
    else:
        file, who = "", "the process of this job"
        where = f"between two steps, {_when(account, box)}"
    parts = [f"{who} {manner} {where}."]
    if participant:
        parts.append(f"Last inputs: {_last_inputs(participant, box)}.")
    if remedy or file:
        parts.append(remedy or _REMEDY.format(file=file))
    lines = printed.strip().splitlines()
    if lines:
        parts.append(f"It printed last: '{lines[-1][-LONGEST_QUOTE:]}'.")
    return " ".join(parts)


def _named(stepped: Stepped | None, name: str) -> Participant | None:
    return next((c for c in stepped.components if c.name == name), None) if stepped else None


def _when(account: Account, box: BlackBox) -> str:
    return f"at {_time(account.stepped, box)}" if account.stepped else account.unstepped


def _time(stepped: Stepped, box: BlackBox) -> str:
    tick = box.mark()[0]
    return f"t = {tick * stepped.tick:.6g} s, tick {tick}"


def _last_inputs(participant: Participant, box: BlackBox) -> str:
    """As `twin.cosim.component.named_values`, which would bring numpy into a supervisor that lives without it."""
    values = list(box.inputs(participant.first_input, sum(size for _, size, _ in participant.inputs)))
    texts = []
    for name, size, unit in participant.inputs:
        part, values = values[:size], values[size:]
        shown = f"{part[0]:.6g}" if size == 1 else "(" + ", ".join(f"{v:.6g}" for v in part) + ")"
        texts.append(f"{name} = {shown}" + ("" if unit == "1" else f" {unit}"))
    return ", ".join(texts) or "none"
