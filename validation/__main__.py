"""`python -m validation [NAME ...]`: run the yardsticks; without names, all, and write down what they found."""

import json
import platform
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.kernel.errors import nearest
from validation.page import rewritten
from validation.trial import apart, names
from validation.yardstick import Finding

ROOT = Path(__file__).parents[1]
DATA = ROOT / "docs" / "validation.json"
PAGE = ROOT / "docs" / "validation.md"


def line(finding: Finding) -> str:
    """What is said of a finding while they come in."""
    stated = finding.yardstick
    difference = "" if finding.difference is None else f"{finding.difference:.2g} {stated.unit}, {finding.quantity}"
    text = finding.remark or f"{difference}; at most {stated.bound:g}"
    return f"{finding.verdict:<9} {finding.name}: {stated.claim}\n          {text}"


def code(findings: Sequence[Finding]) -> int:
    """The exit code: 1 if one of them does not hold. What was not run has neither passed nor failed."""
    return int(any(finding.verdict not in ("holds", "not run") for finding in findings))


def commit() -> str:
    """The commit of the working tree, with -dirty if files differ from it."""
    command = ["git", "describe", "--always", "--dirty", "--exclude=*"]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.strip()


def main(wanted: Sequence[str]) -> int:
    """Run them, tell and, if these are all, write the page and its data; the exit code."""
    for name in wanted:
        if name not in names():
            print(f"{name}: no such yardstick; {nearest(name, names(), 'there are {}')}", file=sys.stderr)
            return 2
    findings: list[Finding] = []
    for name in wanted or names():
        come = apart(name)
        findings += come
        print("\n".join(map(line, come)), flush=True)
    if not wanted:
        facts: dict[str, Any] = {
            "commit": commit(),
            "platform": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
            "findings": [finding.facts for finding in findings],
        }
        DATA.write_text(json.dumps(facts, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
        PAGE.write_text(rewritten(PAGE.read_text(encoding="utf-8"), facts), encoding="utf-8")
    return code(findings)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
