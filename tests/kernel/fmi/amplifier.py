"""An amplifier for drives of parts: velocity_servo's lag and limits, its variables called and measured as voltages."""

from pathlib import Path

from tests.kernel.fmi.archives import DESCRIPTION, altered, redescribed

RENAMED = {
    'name="omega_ref"': 'name="u_cmd"',
    'name="omega_m"': 'name="u_out"',
    'name="theta_m" valueReference="2" causality="output"': 'name="integral" valueReference="2" causality="local"',
    'name="tau_motor" valueReference="4" causality="output"': 'name="unused" valueReference="4" causality="local"',
    'name="tau_load" valueReference="1" causality="input"': 'name="no_load" valueReference="1" causality="local"',
}
VOLT = '<Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1" /></Unit></UnitDefinitions>'


def amplifier(root: Path, file: Path) -> Path:
    """`file`, an FMU: u_out [V] follows u_cmd [V] with a lag of T_m."""

    def change(name: str, content: bytes) -> tuple[str, bytes]:
        if name != DESCRIPTION:
            return name, content
        text = content.decode()
        for old, new in RENAMED.items():
            assert old in text, old
            text = text.replace(old, new)
        return name, text.replace('unit="rad/s"', 'unit="V"').replace("</UnitDefinitions>", VOLT).encode()

    return altered(root / "fmus" / "velocity_servo" / "velocity_servo.fmu", file, change)


def parts_of_a_drive(root: Path, folder: Path) -> Path:
    """`folder` with amplifier.fmu and motor.fmu: brushed_dc, whose voltage is called u."""
    folder.mkdir(exist_ok=True)
    amplifier(root, folder / "amplifier.fmu")
    redescribed(root / "fmus/brushed_dc/brushed_dc.fmu", folder / "motor.fmu", 'name="u_cmd"', 'name="u"')
    return folder
