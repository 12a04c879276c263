"""`python -m tests.mutants`: draw mutants, try each, list those that no test notices.

The same draw goes on where its record ends, at the commit of the record, whatever has been changed since.
"""

import argparse
import datetime
import random
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.mutant import Mutant, drawn, possible_mutants
from tests.mutants.place import Place
from tests.mutants.report import Key, Report, commit_of

REPOSITORY = Path(__file__).parents[2]
RECORD = REPOSITORY / "results" / "mutants.jsonl"
TARGET = 0.9


def main() -> int:
    """Try the mutants; 0 if at least `TARGET` of them are killed, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="how many mutants to draw")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6), help="of the draw; printed")
    parser.add_argument("--jobs", type=int, default=2, help="worktrees side by side")
    parser.add_argument("--rooms", nargs="*", help="only mutants in these rooms of twin/")
    parser.add_argument("--commit", help="of the source; default: that of the record, or the present one")
    parser.add_argument("--record", type=Path, default=RECORD, help="file that says what became of each mutant")
    asked = parser.parse_args()
    draw = {"seed": asked.seed, "count": asked.count, "rooms": asked.rooms}
    draw["commit"] = _full(asked.commit) if asked.commit else commit_of(asked.record, draw) or _full("HEAD")
    with ExitStack() as ends:
        folder = Path(ends.enter_context(tempfile.TemporaryDirectory(prefix="mutants-")))
        places = []
        for number in range(asked.jobs):
            places.append(Place(REPOSITORY, folder / str(number), draw["commit"]))
            ends.callback(places[-1].close)
        every = possible_mutants(places[0].root)
        possible = [one for one in every if not asked.rooms or one.room in asked.rooms]
        mutants = drawn(possible, asked.count, asked.seed)
        report = Report(asked.record, draw)
        left = [mutant for mutant in mutants if _key(mutant) not in report.outcomes]
        print(f"seed {asked.seed}: {len(mutants)} of {len(possible)} possible mutants, {len(left)} left", flush=True)
        print(f"if this ends early, --seed {asked.seed} goes on", flush=True)
        if left:
            _try_all(left, places, report)
    print(f"\n{report.text(len(possible), datetime.date.today().isoformat())}")
    return 0 if report.killed >= TARGET else 1


def _try_all(mutants: list[Mutant], places: list[Place], report: Report) -> None:
    """Note in `report` what becomes of each of `mutants` as it is known."""
    free: SimpleQueue[Place] = SimpleQueue()
    begin = time.monotonic()
    with ThreadPoolExecutor(len(places)) as threads:
        rooms = sorted({mutant.room for mutant in mutants})
        seconds = max(threads.map(lambda place: place.warm(rooms), places))
        print(f"tests without a mutant: {seconds:.0f} s", flush=True)
        for place in places:
            free.put(place)

        def tried(mutant: Mutant) -> str:
            place = free.get()
            try:
                return place.tried(mutant)
            finally:
                free.put(place)

        # in the order of the draw, by one thread: a line is never written into another
        for mutant, outcome in zip(mutants, threads.map(tried, mutants), strict=True):
            report.note(_key(mutant), mutant.line, outcome)
            took = time.monotonic() - begin
            print(f"{len(report.outcomes):4d}  {took:6.0f} s  {outcome:9}  {_name(mutant)}", flush=True)


def _full(commit: str) -> str:
    """The whole name of a commit."""
    asked = ["git", "rev-parse", "--verify", f"{commit}^{{commit}}"]
    return subprocess.run(asked, cwd=REPOSITORY, check=True, capture_output=True, text=True).stdout.strip()


def _key(mutant: Mutant) -> Key:
    return str(mutant.file), mutant.operator, mutant.occurrence


def _name(mutant: Mutant) -> str:
    compiled = " (compiled)" if mutant.is_compiled else ""
    return f"{mutant.file}:{mutant.line} {mutant.operator.removeprefix('core/')} {mutant.occurrence}{compiled}"


if __name__ == "__main__":
    raise SystemExit(main())
