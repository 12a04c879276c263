"""A column map that is wrong is refused with the map to write."""

from pathlib import Path

import pytest

from tests.studies.replay.logs import ANGLES, FIG4, SCALE, healthy, ran, write_log
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import read_log
from twin.studies.identify.identification import identify_log
from twin.studies.replay.replay import replay_log

assert SCALE
RIGHT = [*ANGLES, "scale.F_z=scale.F_z[N]"]


def changed(name: str) -> list[str]:
    """The right map with one mistake."""
    maps = "\n".join(RIGHT)
    if name == "force":
        maps = maps.replace("=scale.F_z", "=-scale.F_z")
    elif name == "legs":
        maps = maps.replace("q_m1", "?").replace("q_m2", "q_m1").replace("?", "q_m2")
    elif name == "sides":
        maps = maps.replace("q_m", "?").replace("q_l", "q_m").replace("?", "q_l")
    elif name == "opposite":
        maps = maps.replace("=q_m2", "=-q_m2")
    else:
        maps = maps.replace("[deg]", "[rad]")
    return maps.splitlines()


@pytest.mark.parametrize("what", ["force", "legs", "sides", "degrees", "opposite"])
def test_replay_and_identify_refuse_a_wrong_map_with_the_one_to_write(tmp_path: Path, what: str):
    path = write_log(tmp_path / "a.csv", ran(FIG4), angles=True)
    for judge in (replay_log, identify_log):
        with pytest.raises(LogError, match="write in the map:") as refusal:
            judge(read_log(path, column_map(changed(what))), healthy())
        (tmp_path / "map.toml").write_text(str(refusal.value).split("write in the map:\n")[1])
        if what != "degrees":
            replay_log(read_log(path, column_map([tmp_path / "map.toml"])), healthy())
