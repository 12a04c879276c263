"""Options that earlier versions had: each is refused with what to type in its place."""

from collections.abc import Sequence

from twin.kernel.errors import InputRefused

WITHDRAWN = {
    ("branch", "--drive"): "type twin run EXPERIMENT --drive FMU, a run with it from the start",
    ("cosim", "--remote"): "leave it out; all FMUs of a system run on this machine",
    ("cosim", "--tolerance"): "type --tick-ms MS, a step that is short enough",
}
"""(Command, option) -> what to type in its place."""


def refuse_withdrawn(words: Sequence[str]) -> None:
    """Refuse a command line with an option that its command no longer has.

    Raises:
        InputRefused: the first of them.
    """
    for word in words[1:]:
        option = word.partition("=")[0]
        if instead := WITHDRAWN.get((words[0], option)):
            raise InputRefused(f"twin {words[0]}: {option} is no longer an option; {instead}")
