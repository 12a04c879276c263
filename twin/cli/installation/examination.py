"""Everything looked at, and what it comes to."""

import json
from collections.abc import Sequence
from pathlib import Path

from twin.cli.installation.caches import compiled_finding, unpacked_finding
from twin.cli.installation.finding import Finding, is_ready, lacking
from twin.cli.installation.surroundings import (
    browser_finding,
    disk_finding,
    drives_finding,
    home_finding,
    isolation_finding,
    smoke_finding,
)
from twin.kept import kept
from twin.places import HOME, is_clone
from twin.studies.lines import wrapped


def examined(here: Path, with_run: bool) -> list[Finding]:
    """What this installation has and lacks, for who works in the folder `here`; `with_run`: run something, too."""
    home = home_finding()
    if home.state == "bad":
        return [home]
    findings = [home, *_packages()]
    findings += [compiled_finding(), drives_finding(here), unpacked_finding(), isolation_finding()]
    findings += [disk_finding(here), *([browser_finding()] if is_clone() else [])]
    return [*findings, smoke_finding(HOME)] if with_run else findings


def _packages() -> list[Finding]:
    """Those of `package_findings`, which takes longer than all others: looked at anew when any package is another."""
    project = HOME / "pyproject.toml"

    def looked_at() -> str:
        from twin.cli.installation.packages import package_findings, project_table

        return json.dumps(package_findings(project_table(), is_clone()))

    said = kept("packages", looked_at, lambda: project.read_bytes().decode("latin-1") if project.is_file() else "")
    return [Finding(*facts) for facts in json.loads(said)]


def verdict(findings: Sequence[Finding]) -> str:
    """`ready`, `ready, without: live` or `not ready: packages`."""
    if not is_ready(findings):
        return "not ready: " + ", ".join(finding.topic for finding in findings if finding.state == "bad")
    without = lacking(findings)
    return f"ready, without: {', '.join(without)}" if without else "ready"


def examination_text(findings: Sequence[Finding]) -> str:
    """The verdict, then the findings, at most 80 columns but for paths."""
    lines = [verdict(findings)]
    for finding in findings:
        lines += wrapped(finding.text, f"  {finding.state:6} {finding.topic:10} ", whole=True)
    return "\n".join(lines)
