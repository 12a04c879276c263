"""`python -m tests.mutants`: draw mutants, try each, list those that no test notices.

The same draw goes on where its record ends, at the commit of the record, whatever has been changed since. What the
tests of a commit run and compile is kept until a draw of it is done.
"""

import argparse
import datetime
import fcntl
import os
import random
import shutil
import subprocess
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue

from tests.mutants.mutant import Mutant, drawn, possible_mutants
from tests.mutants.place import Place
from tests.mutants.report import IN_ROOM, Key, Report, commit_of

REPOSITORY = Path(__file__).parents[2]
RECORD = REPOSITORY / "results" / "mutants.jsonl"
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twin-mutants"
"""Of the user; a folder for each commit."""
TARGET = 0.9


def main() -> int:
    """Try the mutants; 0 if at least `TARGET` of them are killed, else 1."""
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=__doc__)
    parser.add_argument("--count", type=int, default=400, help="how many mutants to draw")
    parser.add_argument("--seed", type=int, default=random.randrange(10**6), help="of the draw; printed")
    parser.add_argument("--jobs", type=int, default=2, help="trees side by side")
    parser.add_argument("--rooms", nargs="*", help="only mutants in these rooms of twin/")
    parser.add_argument("--commit", help="of the source; default: that of the record, or the present one")
    parser.add_argument("--record", type=Path, default=RECORD, help="file that says what became of each mutant")
    asked = parser.parse_args()
    draw = {"seed": asked.seed, "count": asked.count, "rooms": asked.rooms}
    draw["commit"] = _full(asked.commit) if asked.commit else commit_of(asked.record, draw) or _full("HEAD")
    home = CACHE.resolve() / draw["commit"][:12]
    home.mkdir(0o700, parents=True, exist_ok=True)
    with (home / "lock").open("w") as lock:
        # another session would try its mutants in the same trees
        fcntl.flock(lock, fcntl.LOCK_EX)
        places = [Place(REPOSITORY, home / str(number), draw["commit"]) for number in range(asked.jobs)]
        every = possible_mutants(places[0].root)
        possible = [one for one in every if not asked.rooms or one.room in asked.rooms]
        mutants = drawn(possible, asked.count, asked.seed)
        report = Report(asked.record, draw)
        print(f"seed {asked.seed}: {len(mutants)} of {len(possible)} possible mutants", flush=True)
        print(f"if this ends early, --seed {asked.seed} goes on", flush=True)
        left = [mutant for mutant in mutants if _key(mutant) not in report.outcomes]
        _try_all(left, places, report, lambda mutant: mutant.room)
        # they take minutes, and few mutants are left for them
        left = [mutant for mutant in mutants if report.outcomes[_key(mutant)] == IN_ROOM]
        _try_all(left, places, report, lambda mutant: "laws")
        shutil.rmtree(home)
    print(f"\n{report.text(len(possible), datetime.date.today().isoformat())}")
    return 0 if report.killed >= TARGET else 1


def _try_all(mutants: list[Mutant], places: list[Place], report: Report, folder_of: Callable[[Mutant], str]) -> None:
    """Note in `report` what becomes of each of `mutants`, tried against a folder of tests/, as it is known."""
    if not mutants:
        return
    free: SimpleQueue[Place] = SimpleQueue()
    begin = time.monotonic()
    with ThreadPoolExecutor(len(places)) as threads:
        folders = sorted({folder_of(mutant) for mutant in mutants})
        seconds = max(threads.map(lambda place: place.warm(folders), places))
        print(f"{len(mutants)} mutants against {', '.join(folders)}: {seconds:.0f} s without a mutant", flush=True)
        for place in places:
            free.put(place)

        def tried(mutant: Mutant) -> str:
            place = free.get()
            try:
                return place.tried(mutant, folder_of(mutant))
            finally:
                free.put(place)

        # in the order of the draw, by one thread: a line is never written into another
        for mutant, outcome in zip(mutants, threads.map(tried, mutants), strict=True):
            if outcome == "survived" and folder_of(mutant) == mutant.room:
                outcome = IN_ROOM
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
