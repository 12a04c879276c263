"""Replay, identify, shadow and compare read one log by one rule: the same rows kept, the same logs refused."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.conftest import examples
from tests.kernel.recording.logs.bags import bag
from tests.kernel.recording.logs.bags import joints as joint_message
from tests.studies.replay.logs import EXPERIMENTS, FIG4, ran
from tests.studies.shadow.test_following import EXPERIMENT, MODEL
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogError
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.reader import read
from twin.studies.compare.comparison import compare_logs
from twin.studies.identify.identification import identify_log
from twin.studies.replay.samples import robot_samples
from twin.studies.shadow.following import twin_of
from twin.studies.shadow.mapping import wanted_signals
from twin.studies.shadow.session import Session
from twin.studies.shadow.sources import open_source
from twin.studies.shadow.study import shadow

ROWS = 60
LEARNING = 21
"""Rows until a session knows which messages of two topics belong together."""
PERIOD = 0.002
NAMES = ("m1", "m2", "m3", "l1", "l2", "l3")
SIGNALS = [f"estimator.theta_{name[0]}[{int(name[1]) - 1}]" for name in NAMES]
CSV_MAP = [f"{signal}={name}_rad" for signal, name in zip(SIGNALS, NAMES, strict=True)]
APART = 4e-5
"""s between the message of the motors and that of the joints."""
Holes = dict[tuple[int, int], str]
"""(row, encoder) -> "nan", or "none": no sample."""


def angles() -> NDArray[np.float64]:
    run = ran(FIG4)
    return np.hstack([run["estimator.theta_m"], run["estimator.theta_l"]])[:ROWS]


def csv(path: Path, holes: Holes, cut: bool) -> Path:
    lines = ["t_s," + ",".join(f"{name}_rad" for name in NAMES) + ",state"]
    for k, row in enumerate(angles().tolist()):
        cells = [{"": repr(value), "nan": "nan", "none": ""}[holes.get((k, j), "")] for j, value in enumerate(row)]
        lines.append(",".join([repr(PERIOD * k), *cells, '"on, ok"']))
    text = "\n".join([*lines, ""])
    path = path / "a.csv"
    path.write_text(text[:-30] if cut else text)
    return path


def ros_bag(path: Path, holes: Holes, topics: Sequence[slice]) -> Path:
    """A bag with one message for the encoders of each slice, a little later than that of the slice before."""
    messages: dict[str, Sequence[tuple[float, Any]]] = {}
    for k, row in enumerate(angles().tolist()):
        for place, part in enumerate(topics):
            said = {
                NAMES[j]: math.nan if holes.get((k, j)) == "nan" else row[j]
                for j in range(*part.indices(6))
                if holes.get((k, j)) != "none"
            }
            t = 1000.0 + PERIOD * k + APART * place
            topic = f"/js{place or ''}"
            messages[topic] = [*messages.get(topic, ()), (t, joint_message(t, **said))]
    return bag(path / "bag", messages)


def in_replay(log: Log) -> list[float]:
    return robot_samples(log, MODEL.belief).t.tolist()


def in_shadow(path: Path, maps: Sequence[str], folder: Path) -> list[float]:
    """Times of the samples that a session records, from the first one on."""
    columns, wanted = column_map(maps), wanted_signals(MODEL.belief)
    source, named, live = open_source(str(path), columns, wanted, MODEL.belief, 0.0, [])
    twin = twin_of(EXPERIMENT, MODEL, "robot", None)
    messages = named if source.topic_types() else {}
    session = Session(source, messages, wanted, twin, MODEL, 0.03, np.inf, live, lambda text: None)
    session.wait_for_topics()
    session.follow(lambda: folder / "run.mcap")
    return [float(t) for t in read(folder / "run.mcap").time("encoder")]


holes = st.dictionaries(
    st.tuples(st.integers(0, ROWS - 1), st.integers(0, 5)), st.sampled_from(["nan", "none"]), max_size=6
)


@examples(20)
@given(holes=holes, form=st.sampled_from(["csv", "cut csv", "bag", "bag of two topics"]))
def test_four_commands_keep_the_same_rows_and_refuse_the_same_logs(
    tmp_path_factory: pytest.TempPathFactory, holes: Holes, form: str
):
    folder = tmp_path_factory.mktemp("a")
    # which topics belong together is learnt from the first messages, as beside a robot that runs
    learnt = 0 if form != "bag of two topics" else LEARNING
    if learnt:
        holes = {(k, j): kind for (k, j), kind in list(holes.items())[:1] if k >= learnt}
    if "csv" in form:
        path, maps, last = csv(folder, holes, form == "cut csv"), CSV_MAP, ROWS - (form == "cut csv")
    else:
        topics = [slice(0, 6)] if form == "bag" else [slice(0, 3), slice(3, 6)]
        path, last = ros_bag(folder, holes, topics), ROWS
        where = dict.fromkeys(NAMES[:3], "/js") | dict.fromkeys(NAMES[3:], "/js" if form == "bag" else "/js1")
        maps = [f"{signal}={where[name]}.position.{name}" for signal, name in zip(SIGNALS, NAMES, strict=True)]
    broken = {k for k, _ in holes if k < last}
    kept = [PERIOD * k for k in range(last) if k not in broken]
    invalid = len({k for (k, _), kind in holes.items() if kind == "nan" and k < last})
    log = read_log(path, column_map(maps))
    if invalid > 0.05 * (len(kept) + invalid):
        said = []
        for read_it in (
            lambda: in_replay(log), lambda: identify_log(log, MODEL), lambda: in_shadow(path, maps, folder)
        ):  # fmt: skip
            with pytest.raises(LogError) as refused:
                read_it()
            said.append(str(refused.value))
        assert len(set(said)) == 1 and f"{invalid} of {len(kept) + invalid} samples of an encoder" in said[0]
        return
    found = np.array(in_replay(log))
    np.testing.assert_allclose(found - found[0], np.array(kept) - kept[0], atol=1e-9)
    shadowed = np.array(in_shadow(path, maps, folder))
    found = found[learnt:]
    np.testing.assert_allclose(shadowed - shadowed[0], found - found[0], atol=1e-9)
    rows = compare_logs(log, log).rows
    numbers = {signal: sum((k, j) not in holes for k in range(last)) for j, signal in enumerate(SIGNALS)}
    assert {row.signal: row.n for row in rows} == numbers


def test_rows_of_two_topics_before_their_periods_are_known_are_counted_and_reported(tmp_path: Path):
    path = ros_bag(tmp_path, {}, [slice(0, 3), slice(3, 6)])
    maps = [
        f"{signal}=/js{'' if name[0] == 'm' else 1}.position.{name}"
        for signal, name in zip(SIGNALS, NAMES, strict=True)
    ]
    report = shadow(EXPERIMENTS / f"{FIG4}.toml", str(path), maps, speed=0.0, no_alarm=True, out=tmp_path / "out")
    counts = report.facts["counts"]
    assert (counts["unmatched"], counts["samples"]) == (LEARNING, ROWS - LEARNING)
    assert f"{LEARNING} before the first left out" in report.text
    assert f"{LEARNING} incomplete samples before the first complete one left out" in " ".join(report.text.split())
