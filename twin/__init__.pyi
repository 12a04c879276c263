from twin.experiment.experiment import Experiment as Experiment
from twin.recording.reader import read as read
from twin.runs.run import Run as Run
from twin.studies.check.check import check as check

__version__: str
__all__: list[str]
