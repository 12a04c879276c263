"""`python -m tests.mutants`: draw mutants, try each, list those that no test notices."""

import argparse
import json
import random
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.mutant import Mutant, drawn, possible_mutants
from tests.mutants.place import Place

REPOSITORY = Path(__file__).parents[2]
REPORT = REPOSITORY / "results" / "mutants.jsonl"
TARGET = 0.9
PATIENCE = 3.0
"""A mutant is given this many times what all tests took without one: an endless loop is noticed, too."""


def main() -> int:
    """Try the mutants; 0 if at least `TARGET` of them are killed, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="how many mutants to draw")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6), help="of the draw; printed")
    parser.add_argument("--jobs", type=int, default=2, help="worktrees side by side")
    parser.add_argument("--rooms", nargs="*", help="only mutants in these rooms of twin/")
    asked = parser.parse_args()
    possible = [one for one in possible_mutants(REPOSITORY) if not asked.rooms or one.room in asked.rooms]
    mutants = drawn(possible, asked.count, asked.seed)
    print(f"seed {asked.seed}: {len(mutants)} of {len(possible)} possible mutants", flush=True)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        places = [Place(REPOSITORY, Path(folder) / str(number)) for number in range(asked.jobs)]
        try:
            outcomes = _all_tried(mutants, places)
        finally:
            for place in places:
                place.close()
    return _told(outcomes)


def _all_tried(mutants: list[Mutant], places: list[Place]) -> dict[Mutant, str]:
    """What became of each of `mutants`, noted in `REPORT` as it is known."""
    free: SimpleQueue[Place] = SimpleQueue()
    outcomes: dict[Mutant, str] = {}
    begin = time.monotonic()
    with ThreadPoolExecutor(len(places)) as threads, REPORT.open("w") as report:
        rooms = sorted({mutant.room for mutant in mutants})
        timeout = PATIENCE * max(threads.map(lambda place: place.warm(rooms), places))
        print(f"tests without a mutant: {timeout / PATIENCE:.0f} s", flush=True)
        for place in places:
            free.put(place)

        def tried(mutant: Mutant) -> None:
            place = free.get()
            try:
                outcomes[mutant] = place.tried(mutant, timeout)
            finally:
                free.put(place)
            facts = {"file": str(mutant.file), "line": mutant.line, "operator": mutant.operator}
            print(json.dumps({**facts, "occurrence": mutant.occurrence, "outcome": outcomes[mutant]}), file=report)
            report.flush()
            took = time.monotonic() - begin
            print(f"{len(outcomes):4d}  {took:6.0f} s  {outcomes[mutant]:9}  {_name(mutant)}", flush=True)

        list(threads.map(tried, mutants))
    return outcomes


def _told(outcomes: dict[Mutant, str]) -> int:
    survivors = [mutant for mutant, outcome in outcomes.items() if outcome == "survived"]
    killed = 1 - len(survivors) / len(outcomes)
    print(f"\nkilled {killed:.1%} of {len(outcomes)} ({Counter(outcomes.values())}); survivors:")
    for mutant in sorted(survivors, key=lambda one: (one.file, one.line)):
        print(f"  {_name(mutant)}")
    return 0 if killed >= TARGET else 1


def _name(mutant: Mutant) -> str:
    compiled = " (compiled)" if mutant.is_compiled else ""
    return f"{mutant.file}:{mutant.line} {mutant.operator.removeprefix('core/')} {mutant.occurrence}{compiled}"


if __name__ == "__main__":
    raise SystemExit(main())
