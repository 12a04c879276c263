"""Column layout of a robot's sample: its signals, in order."""

from twin.kernel.cosim.port import Port, port_slices

INPUTS = (
    Port("count_m", 3, "1", "motor encoder counts; NaN: none came"),
    Port("count_l", 3, "1", "joint encoder counts; NaN: none came"),
    Port("omega_ref", 3, "rad/s", "motor speeds commanded from this sample on; NaN: not known"),
    Port("F_z", 1, "N", "measured pressing force; NaN: none"),
    Port("tau_motor", 3, "N m", "torque of the motors, by their currents; NaN: none"),
)
"""Signals of a sample, in the order of its columns."""
COUNT_M, COUNT_L, OMEGA_REF, F_Z, TAU = (port_slices(INPUTS)[port.name] for port in INPUTS)
ENCODERS = slice(COUNT_M.start, COUNT_L.stop)
"""Columns of the six encoder counts, which each sample must have."""
