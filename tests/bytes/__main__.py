"""`python -m tests.bytes`: does the working tree do what a commit did, byte for byte?

What the commit came to is kept, by commit and machine, so that it is done once.
"""

import argparse
import fnmatch
import gzip
import hashlib
import json
import os
import platform
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import asdict
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

from tests.bytes.case import Case
from tests.bytes.cases import all_cases
from tests.bytes.comparison import differences
from tests.bytes.tree import REPOSITORY, Tree

BASE = "bf6967cc"
"""The commit before the change that is to move no byte."""
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "twin-bytes"
"""Of the user, for all worktrees."""
WHAT_DECIDES = ("outputs", "page", "recording", "tree", "worker")
"""Modules that decide what a case comes to."""


def main() -> int:
    """Compare; 0 if everything is the same, 1 if something differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.bytes", description=__doc__)
    parser.add_argument("--base", default=BASE, help="the commit to compare with; without it %(default)s")
    parser.add_argument("--quick", action="store_true", help="a part of the cases, in a minute")
    parser.add_argument("--only", action="append", help="cases by name, such as 'run pressing*'; may be repeated")
    parser.add_argument("--jobs", type=int, default=2, help="workers side by side")
    parser.add_argument("--keep", default="", help="folder in which what the cases leave is kept, of both trees")
    parser.add_argument(
        "--cache", type=Path, default=CACHE, help="where both trees and what the commit came to are kept"
    )
    parser.add_argument("--list", action="store_true", help="print the names of the cases and end")
    asked = parser.parse_args()
    began = time.monotonic()
    commit = subprocess.run(
        ["git", "rev-parse", "--verify", f"{asked.base}^{{commit}}"], cwd=REPOSITORY, capture_output=True, text=True
    )
    if commit.returncode:
        print(f"{asked.base}: no such commit here; fetch it, or name another with BASE=...", file=sys.stderr)
        return 2
    home = asked.cache.resolve()
    with closing(Tree(home, commit.stdout.strip())) as base:
        cases = [
            case
            for case in all_cases(base.root)
            if (case.quick or not asked.quick)
            and any(fnmatch.fnmatchcase(case.name, pattern) for pattern in asked.only or "*")
        ]
        if asked.list:
            print(*(case.name for case in cases), sep="\n")
            return 0
        store = home / f"{_machine(base.root, commit.stdout.strip())}.json.gz"
        known: dict[str, Any] = _read(store)
        missing = [case for case in cases if asked.keep or _key(case) not in known]
        print(f"{len(cases)} cases; {len(missing)} of them not yet done by {asked.base}", flush=True)
        new: dict[str, Any] = {}
        base.do(missing, asked.jobs, asked.keep and f"{asked.keep}/before", _noted(new, len(missing), began))
        if new:
            known |= new
            _write(store, known)
    found: dict[str, Any] = {}
    with closing(Tree(home, "")) as work:
        work.do(cases, asked.jobs, asked.keep and f"{asked.keep}/after", _noted(found, len(cases), began))
    different = 0
    for case in cases:
        parts = differences(known[_key(case)], found[_key(case)])
        different += bool(parts)
        for part in parts:
            print(f"{case.name}: {part}")
    print(f"{different} of {len(cases)} cases differ from {asked.base}; {time.monotonic() - began:.0f} s")
    return 1 if different else 0


def _noted(found: dict[str, Any], count: int, began: float) -> Any:
    def note(case: Case, came_to: dict[str, Any]) -> None:
        found[_key(case)] = came_to
        if len(found) % 50 == 0 or len(found) == count:
            print(f"  {len(found)} of {count}, {time.monotonic() - began:.0f} s", flush=True)

    return note


def _key(case: Case) -> str:
    return hashlib.sha256(json.dumps(asdict(case)).encode()).hexdigest()


def _machine(root: Path, commit: str) -> str:
    """The name under which what `commit` came to on this machine, with these packages and this code, is kept."""
    code = [Path(__file__).with_name(f"{name}.py").read_bytes() for name in WHAT_DECIDES]
    packages = sorted(f"{one.name} {one.version}" for one in distributions())
    about = [platform.node(), platform.machine(), _processor(), sys.version, str(root), *packages]
    digest = hashlib.sha256(b"\0".join([*code, *(text.encode() for text in about)])).hexdigest()
    return f"{commit[:12]}_{digest[:12]}"


def _processor() -> str:
    """Its form, on which the last bits of what the mathematical libraries give may depend."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        return platform.processor()
    return "\n".join(sorted({line for line in lines if line.startswith(("model name", "flags"))}))


def _read(path: Path) -> dict[str, Any]:
    if not path.exists():
        return {}
    with gzip.open(path, "rt", encoding="utf-8") as file:
        return json.load(file)


def _write(path: Path, content: dict[str, Any]) -> None:
    """Whole or not at all: several may compare at the same time."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    with gzip.open(beside, "wt", 1, encoding="utf-8") as file:
        json.dump(content, file)
    beside.rename(path)


if __name__ == "__main__":
    sys.exit(main())
