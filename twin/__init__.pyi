from twin.experiment.experiment import Experiment as Experiment
from twin.recording.reader import read as read
from twin.runs.assembly.load import load_experiment
from twin.runs.run import Run as Run
from twin.runs.run import execute
from twin.studies.check.check import check as check

load = load_experiment
run = execute
__version__: str
__all__: list[str]
