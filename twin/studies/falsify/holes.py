"""What a search says nothing of: places where it has not been, and runs that were not judged to their end."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

from twin.studies.falsify.space import Place, Space, Wrong
from twin.studies.lines import counted, wrapped


class Ended(NamedTuple):
    """Why a run did not come to its end.

    Attributes:
        refused: whether it never began, because its values make no experiment.
        reason: the sentence.
    """

    refused: bool
    reason: str


@dataclass(frozen=True)
class Holes:
    """Of the kinds of which no run violates what is required.

    Attributes:
        untried: places where no run of the kind was made, by kind.
        places: of each kind, how many it has.
        ended: runs that did not come to their end, by kind, each with the reason.
        runs: of each kind, how many were made.
    """

    untried: Mapping[str, Sequence[Place]]
    places: Mapping[str, int]
    ended: Mapping[str, Sequence[tuple[Wrong, Ended]]]
    runs: Mapping[str, int]

    @classmethod
    def of(cls, space: Space, tried: Sequence[Wrong], ended: Mapping[Wrong, Ended], violating: Collection[str]) -> Self:
        """Those of a search.

        Args:
            space: where it looked.
            tried: its runs.
            ended: those that did not come to their end.
            violating: kinds that were found to violate.
        """
        kinds = [kind for kind in space.kinds if kind not in violating]
        places = {kind: space.places(kind) for kind in kinds}
        # a run that was refused tried nothing
        been = {(wrong.kind, space.place(wrong)) for wrong in tried if wrong not in ended or not ended[wrong].refused}
        untried = {kind: [place for place in places[kind] if (kind, place) not in been] for kind in kinds}
        broken = {kind: [(wrong, end) for wrong, end in ended.items() if wrong.kind == kind] for kind in kinds}
        return cls(
            {kind: some for kind, some in untried.items() if some},
            {kind: len(some) for kind, some in places.items()},
            {kind: some for kind, some in broken.items() if some},
            {kind: sum(wrong.kind == kind for wrong in tried) for kind in kinds},
        )

    @property
    def kept(self) -> list[str]:
        """Kinds of which every run came to its end, and none violated what is required."""
        return [kind for kind in self.places if kind not in self.ended]

    @property
    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "kept": self.kept,
            "not_tried": [{"kind": kind, **place._asdict()} for kind, some in self.untried.items() for place in some],
            "ended_early": [
                {**vars(wrong), "refused": end.refused, "reason": end.reason}
                for some in self.ended.values()
                for wrong, end in some
            ],
        }

    def lines(self) -> list[str]:
        """Sentences of at most 80 columns, if there is anything to say."""
        lines = []
        for refused, what in ((False, "Ended by a component that failed, judged until then"), (True, "Refused")):
            told = []
            reasons = []
            for kind, some in self.ended.items():
                of_these = [end.reason for _, end in some if end.refused == refused]
                if of_these:
                    told.append(f"{kind} ({len(of_these)} of {counted(self.runs[kind], 'run')})")
                    reasons += of_these
            if told:
                first = (reasons[0].splitlines() or ["no reason was given"])[0]
                lines += wrapped(f"{what}: {', '.join(told)}. The first: {first}")
        if self.untried:
            told = [f"{kind} {len(some)} of {self.places[kind]}" for kind, some in self.untried.items()]
            number = sum(map(len, self.untried.values()))
            text = (
                f"Not tried, {counted(number, 'place')} (target, sign, body; --runs N tries more): {', '.join(told)}."
            )
            lines += wrapped(text)
        return lines
