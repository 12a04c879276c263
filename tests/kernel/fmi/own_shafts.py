"""Foreign drives that leave something to us: a servo that takes an angle, a machine without a shaft."""

from pathlib import Path

from tests.kernel.fmi.archives import altered, redescribed
from tests.kernel.fmi.compiled import compiled_drive, compiled_library

MACHINE = """
#include "model.h"
/* torque per difference of speeds; tau_load is the speed of the shaft */
bool model_step(Variables *v, double h)
{
    v->tau_motor = v->T_m * (v->omega_ref - v->tau_load);
    return h > 0.0;
}
"""


def position_servo(root: Path, folder: Path) -> Path:
    """`folder`/servo.fmu, of servo.c."""
    good = root / "fmus" / "smart_servo" / "smart_servo.fmu"
    source = Path(__file__).with_name("servo.c").read_text()
    library = compiled_library(good, folder / "servo.build", {"model.c": source})
    built = altered(
        good, folder / "built.fmu", lambda n, c: (n, library if n == "binaries/linux64/smart_servo.so" else c)
    )
    return redescribed(built, folder / "servo.fmu", *unit("once per bus cycle", "rpm", "deg"))


def machine(root: Path, folder: Path) -> Path:
    """`folder`/machine.fmu: takes a speed and that of its shaft, as `tau_load`, and gives a torque."""
    built = compiled_drive(root, folder, "built", {"model.c": MACHINE})
    return redescribed(built, folder / "machine.fmu", *unit("opposes positive omega_m", "N.m", "rad/s"))


def unit(described: str, old: str, new: str) -> tuple[str, str]:
    """What to replace in a description for another unit of the input whose description ends so."""
    start = f'{described}">\n      <Real start="0.0" unit='
    return f'{start}"{old}"', f'{start}"{new}"'
