"""All claims of Fig. 5 on the tasks of any number of runs."""

from collections.abc import Sequence
from dataclasses import dataclass

from twin.experiment.task import Press, Push, Roll, Tap, Task
from twin.recording.recording import Recording
from twin.studies.paper.claim import ClaimFinding, as_facts, judged
from twin.studies.paper.fig5 import CLAIMS
from twin.studies.paper.fig5_runs import TaskRun, body_of, drive_of, task_runs, trip_sentence
from twin.studies.paper.score import failed


@dataclass(frozen=True)
class TaskScore:
    """One task and what it says to the claims of its kind.

    Attributes:
        run: the task's curves.
        drive, body: by name.
        name: of the task among those of the run, `push 2`.
        manner: what was asked for, in words.
        findings: in the order of the claims.
    """

    run: TaskRun
    drive: str
    body: str
    name: str
    manner: str
    findings: tuple[ClaimFinding, ...]

    @property
    def kind(self) -> str:
        return self.run.task.kind

    def facts(self) -> dict[str, object]:
        """For JSON."""
        return {
            "recording": str(self.run.recording.path),
            "drive": self.drive,
            "body": self.body,
            "task": self.run.number,
            "kind": self.kind,
            "manner": self.manner,
            "failed": failed(self.findings),
            "claims": [as_facts(finding) for finding in self.findings],
        }


@dataclass(frozen=True)
class Fig5Score:
    """What runs say to Fig. 5.

    Attributes:
        tasks: in the order of the runs and of the tasks in them.
        remarks: a sentence on each run that tripped or is damaged.
    """

    tasks: tuple[TaskScore, ...]
    remarks: tuple[str, ...]

    @property
    def findings(self) -> list[ClaimFinding]:
        return [finding for task in self.tasks for finding in task.findings]

    @property
    def failed(self) -> list[str]:
        """Keys of the claims that fail anywhere, each once."""
        return list(dict.fromkeys(failed(self.findings)))

    def facts(self) -> dict[str, object]:
        """For JSON."""
        return {
            "figure": "5",
            "failed": self.failed,
            "tasks": [task.facts() for task in self.tasks],
            "remarks": list(self.remarks),
        }


def fig5_score(recordings: Sequence[Recording]) -> Fig5Score:
    """Judge every task of `recordings`.

    Raises:
        InputRefused: one holds no task.
    """
    tasks = [score for recording in recordings for score in _task_scores(recording)]
    remarks = [text for recording in recordings for text in (trip_sentence(recording), recording.note) if text]
    return Fig5Score(tuple(tasks), tuple(remarks))


def shown_tasks(score: Fig5Score) -> list[TaskScore]:
    """Of each kind of task, in the order of Fig. 5, the last one that was begun in the first run that has one."""
    shown = []
    for kind in CLAIMS:
        tasks = [task for task in score.tasks if task.kind == kind and len(task.run.t)]
        if tasks:
            shown.append([task for task in tasks if task.run.recording is tasks[0].run.recording][-1])
    return shown


def _task_scores(recording: Recording) -> list[TaskScore]:
    runs = task_runs(recording)
    drive, body = drive_of(recording), body_of(recording)
    scores = []
    for run in runs:
        findings = tuple(judged(claim, run) for claim in CLAIMS[run.task.kind])
        number = f" {run.number}" if len(runs) > 1 else ""
        scores.append(TaskScore(run, drive, body, f"{run.task.kind}{number}", _manner(run.task), findings))
    return scores


def _manner(task: Task) -> str:
    match task:
        case Press():
            return f"{task.force:g} N for {task.hold:g} s"
        case Tap():
            return f"{task.force:g} N at {1e3 * task.speed:g} mm/s, {task.times} times"
        case Roll():
            return f"{task.force:g} N, radius {1e3 * task.radius:g} mm at {task.rate:g} Hz, {task.turns:g} turns"
        case Push():
            return f"{task.force:g} N at {1e3 * task.speed:g} mm/s"
