"""Co-simulation digital twin of a 3-DOF delta-like massage robot with series elastic joints.

For programs, notebooks and tests: `load`, `run`, `read`, `check` and the types `Experiment` and `Run` (docs/python.md);
`Cosimulation` for FMUs without the robot (docs/ssp.md). Each is imported on first use.
"""

__version__ = "1.0.0"

_PUBLIC_NAMES = {
    "Cosimulation": "twin.kernel.systems.session:Cosimulation",
    "Experiment": "twin.robot.experiment.experiment:Experiment",
    "Run": "twin.robot.run.run:Run",
    "check": "twin.studies.check.job:check",
    "load": "twin.robot.assembly.load:load_experiment",
    "read": "twin.kernel.recording.reader:read",
    "run": "twin.robot.run.run:execute",
}

__all__ = list(_PUBLIC_NAMES)


def __getattr__(name: str):  # type: ignore[no-untyped-def]
    # imported here: until the command line has started, Ctrl-C would print Python's traceback
    from importlib import import_module

    if name not in _PUBLIC_NAMES:
        raise AttributeError(f"module 'twin' has no attribute '{name}'")
    module, _, attribute = _PUBLIC_NAMES[name].partition(":")
    return getattr(import_module(module), attribute)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
