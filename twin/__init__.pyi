from twin.kernel.recording.reader import read as read
from twin.kernel.systems.session import Cosimulation as Cosimulation
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment as Experiment
from twin.robot.run.run import Run as Run
from twin.robot.run.run import execute
from twin.studies.check.check import check as check

load = load_experiment
run = execute
__version__: str
__all__: list[str]
