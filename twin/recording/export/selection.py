"""Which signals of a recording are meant."""

from collections.abc import Sequence
from fnmatch import fnmatchcase

from twin.errors import InputRefused, nearest
from twin.recording.recording import Recording

MANY = 8
"""So many names are not listed in a sentence."""


def selected_signals(recording: Recording, patterns: Sequence[str] = ()) -> tuple[str, ...]:
    """Names `topic.field` that match any of `patterns`, in the order of the file; all of them without a pattern.

    Args:
        patterns: `plant.p_B`, or with wildcards `plant.*`, `*.F_z`; a topic's name alone, `plant`, is all of it.

    Raises:
        InputRefused: a pattern matches nothing, or what is selected has no messages.
    """
    fields = recording.fields()
    for pattern in patterns:
        if not any(_matches(name, pattern) for name in fields):
            raise InputRefused(f"{recording.path}: --signals {pattern}: no such signal; {_nearest(pattern, fields)}")
    chosen = tuple(name for name in fields if not patterns or any(_matches(name, pattern) for pattern in patterns))
    empty = {topic for topic, stream in recording.streams.items() if not len(stream.records)}
    without = [name for name in chosen if name.rpartition(".")[0] in empty]
    if without or not chosen:
        raise InputRefused(f"{recording.path}: {without[0] if without else 'the recording'} has no messages to export")
    return chosen


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or name.rpartition(".")[0] == pattern


def _nearest(pattern: str, fields: dict) -> str:
    names = [*fields, *dict.fromkeys(name.rpartition(".")[0] for name in fields)]
    # the wildcards of a misspelt pattern are no letters to compare
    wanted, topics = pattern.replace("*", ""), names[len(fields) :]
    more = " ..." if len(topics) > MANY else ""
    return nearest(wanted, names, f"there are {', '.join(f'{topic}.*' for topic in topics[:MANY])}{more}", 3)
