"""Parts of another make as text and as facts."""

from collections.abc import Iterator

from twin.cosim.port import Port
from twin.runs.assembly.roles import CONTRACTS
from twin.studies.component.check import Checked
from twin.studies.lines import wrapped


def checked_text(done: Checked) -> str:
    """For people, at most 80 columns."""
    part = done.part
    lines = [f"{part.role}: {part.label}, every {1e3 * done.period:g} ms, sha256 {part.sha256[:12]}"]
    lines += [line for text in part.facts.get("mapped", ()) for line in wrapped(text, "  ", 4)]
    for check in done.checks:
        lines += wrapped(check.detail, f"  {check.verdict:6} {check.name:11} ")
    lines.append(f"  {'':6} {'cost':11} {1e6 * done.cost:.2g} us per call")
    for name, apart in (done.apart or {}).items():
        unit = next(port.unit for port in part.outputs if port.name == name)
        lines.append(f"  {'':6} {name:11} {_apart(apart, unit)}")
    verdict = "can take its place" if done.good else "cannot take its place"
    return "\n".join([*lines, f"{part.label} {verdict} as {part.role}"])


def _apart(apart: float, unit: str) -> str:
    if apart == 0.0:
        return "as twin's own, bit for bit"
    return f"at most {apart:.3g}{'' if unit == '1' else f' {unit}'} from twin's own on the same inputs"


def component_facts(done: Checked) -> dict[str, object]:
    """For programs, SI."""
    part = done.part
    return {
        "role": part.role,
        "part": dict(part.facts),
        "period_s": done.period,
        "inputs": [port.name for port in part.inputs],
        "outputs": [port.name for port in part.outputs],
        "checks": [{"name": c.name, "verdict": c.verdict, "detail": c.detail} for c in done.checks],
        "cost_s": done.cost,
        "largest_difference_to_own": done.apart,
        "good": done.good,
    }


def contracts_text() -> str:
    """Every part and its ports, for people."""
    return "\n".join(line for role in CONTRACTS for line in _contract(role))


def _contract(role: str) -> Iterator[str]:
    contract = CONTRACTS[role]
    yield f"[{role}]"
    for arrow, ports in (("<-", contract.inputs), ("->", contract.outputs)):
        for port in ports:
            needed = " (needed)" if arrow == "->" and port.name in contract.required else ""
            yield from wrapped(f"{port.meaning}{needed}", f"  {arrow} {_sized(port):12} {port.unit:6} ")


def _sized(port: Port) -> str:
    return port.name if port.size == 1 else f"{port.name}[{port.size}]"
