"""What was identified as TOML: a fragment to lay over an experiment, each value with its interval as its source."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import tomlkit

from twin.errors import visible
from twin.studies.identify.identification import Identification
from twin.studies.identify.units import Estimate, decimals, shown
from twin.writing import inline_table


def model_fragment(one: Identification, log: str) -> str:
    """[controller] and [controller.model] with what was found; what was not stays as it is. log: the file's name."""
    belief, q = one.model.belief, one.quantities
    k = one.estimate("k_s_eta")
    d = decimals(k)
    says = f"identified from {log}: k_s eta = {k.value:.{d}f} +- {k.half_width:.{d}f} (95 %)"
    eta = q["eta"].found
    k_s = one.estimate("k_s").value if eta is not None else k.value / belief.eta
    says = says if eta else f"{says}, eta as believed"
    model = {"k_s_Nm_per_rad": inline_table({"value": round(k_s, d), "source": says})}
    if eta is not None:
        model["eta"] = inline_table({"value": round(min(eta.value, 1.0), d), "source": f"identified from {log}"})
    joints = [q[f"joint_zero_{i}"].found for i in (1, 2, 3)]
    believed = np.array(belief.joint_zero)
    zero = np.array([j.value if j else b for j, b in zip(joints, believed, strict=True)]) if all(joints) else believed
    winds = [q[f"wind_up_zero_{i}"].found for i in (1, 2, 3)]
    if all(winds):
        motor = np.array([w.value for w in winds if w]) + belief.N * zero
        model["motor_zero_deg"] = _zeros(motor, f"identified from {log}: within {_width(winds)} of N joint zeros")
    if all(joints):
        model["joint_zero_deg"] = _zeros(zero, f"identified from {log}: +- {_width(joints)}")
    controller: dict[str, Any] = {"model": model}
    backlash = q["backlash"].found
    if backlash is not None and backlash.value >= 0.0:
        digits = decimals(backlash)
        source = f"identified from {log}: +- {shown(backlash.half_width, 'rad'):.{digits}f} deg"
        value = round(shown(backlash.value, "rad"), digits)
        controller = {"dead_zone_deg": inline_table({"value": value, "source": source})} | controller
    head = f"# identified from {visible(log)}; lay it over an experiment, or paste it there\n"
    return head + tomlkit.dumps({"controller": controller})


def _zeros(angles: np.ndarray, source: str) -> Any:
    return inline_table({"value": [round(float(angle), 4) for angle in np.degrees(angles)], "source": source})


def _width(found: Sequence[Estimate | None]) -> str:
    """The widest of the intervals, in degrees."""
    return f"{max(shown(one.half_width, 'rad') for one in found if one):.2g} deg"
