from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tests.kernel.recording import samples
from tests.kernel.recording.logs.bags import bag, joints, wrench
from twin.kernel.errors import InputRefused
from twin.kernel.recording.export.export import export_recording
from twin.kernel.recording.export.ros_bag import _TYPE_DEFINITIONS, type_definition
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.logs.reader import is_recording, read_log
from twin.kernel.recording.reader import read
from twin.studies.export import JOINT_FIELDS


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample recording: topics of periods 1, 2 and 40 ticks, with counts and truth values."""
    return samples.finished(tmp_path_factory.mktemp("run") / "run.mcap")


@pytest.fixture(scope="module")
def folder(run: Path) -> Path:
    """It as a bag."""
    return export_recording(run, "ros2", joints=JOINT_FIELDS).path


def elements(run: Path) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Times and values of every number of a recording, by signal."""
    recording = read(run)
    found = {}
    for name, field in recording.fields().items():
        t, values = recording.time(name.rpartition(".")[0]), recording[name].astype(float)
        for k, column in enumerate(values.reshape(len(t), -1).T):
            found[f"{name}[{k}]" if field.size > 1 else name] = (t, column)
    return found


def test_a_bag_reads_back_to_every_bit_of_the_recording(run: Path, folder: Path):
    log = read_log(folder, column_map([folder / "map.toml"]))
    truth = elements(run)
    assert log.series.keys() == truth.keys()
    for name, (t, values) in truth.items():
        np.testing.assert_array_equal(log[name].t, t)
        np.testing.assert_array_equal(log[name].values, values)
    assert not is_recording(folder)


def test_stamps_are_the_times_of_the_log(folder: Path):
    by_stamp = read_log(folder, {**column_map([folder / "map.toml"]), **column_map(["time=header.stamp"])})
    by_log = read_log(folder, column_map([folder / "map.toml"]))
    assert not any("two clocks" in note for note in by_stamp.notes)
    for name, one in by_log.series.items():
        np.testing.assert_allclose(by_stamp[name].t, one.t, rtol=1e-15, atol=1e-15)


def test_two_readers_of_others_find_the_same_messages(run: Path, folder: Path):
    """rosbags and mcap-ros2-support, each with its own decoder and its own way through the file."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(folder) as reader:
        ours = [(c.topic, t, store.deserialize_cdr(data, c.msgtype)) for c, t, data in reader.messages()]
    with (folder / f"{folder.name}_0.mcap").open("rb") as file:
        theirs = [
            (channel.topic, message.log_time, decoded)
            for _, channel, message, decoded in make_reader(
                file, decoder_factories=[DecoderFactory()]
            ).iter_decoded_messages()
        ]
    recording = read(run)
    assert len(ours) == len(theirs) > sum(len(stream.records) for stream in recording.streams.values())
    p_B, k = recording["plant.p_B"], 0
    for one, other in zip(sorted(ours, key=lambda m: m[:2]), sorted(theirs, key=lambda m: m[:2]), strict=True):
        assert one[:2] == other[:2]
        assert numbers_in(one[2]) == numbers_in(other[2])
        if one[0] == "/plant/p_B":
            position, stamp = other[2].pose.position, other[2].header.stamp
            assert [position.x, position.y, position.z] == p_B[k].tolist()
            assert stamp.sec * 10**9 + stamp.nanosec == one[1]
            k += 1
    assert k == len(p_B)


def numbers_in(message: Any) -> list:
    """Everything a message says, in its order."""
    if isinstance(message, int | float | str):
        return [message]
    if isinstance(message, np.ndarray | list | tuple) or type(message).__name__ == "array":
        return [number for one in message for number in numbers_in(one)]
    inner = {name: getattr(message, name) for name in getattr(message, "__slots__", None) or vars(message)}
    return [number for name, one in inner.items() if not name.startswith("_") for number in numbers_in(one)]


@pytest.mark.parametrize("kind", [kind for kind in _TYPE_DEFINITIONS if "/msg/" in kind])
def test_the_definitions_are_those_of_ros_2(kind: str):
    ours = get_types_from_msg(type_definition(kind), kind)
    theirs = get_typestore(Stores.ROS2_HUMBLE).fielddefs
    for name, (_, fields) in ours.items():
        assert fields == theirs[name][1]


def test_only_what_is_chosen_is_written_and_at_the_rate_asked_for(run: Path, tmp_path: Path):
    export_recording(run, "ros2", ["plant.p_B"], 10.0, tmp_path / "b")
    with Reader(tmp_path / "b") as reader:
        assert [one.topic for one in reader.connections] == ["/plant/p_B"]
        times = [t for _, t, _ in reader.messages()]
    assert set(np.diff(times)) == {100_000_000}


def test_the_same_recording_gives_the_same_bag(run: Path, tmp_path: Path):
    for name in ("a/bag", "b/bag"):
        export_recording(run, "ros2", out=tmp_path / name)
    for file in (tmp_path / "a/bag").iterdir():
        assert file.read_bytes() == (tmp_path / "b/bag" / file.name).read_bytes()
    assert [p.name for p in (tmp_path / "a").iterdir()] == ["bag"]


def test_nothing_but_a_bag_of_twin_is_replaced(run: Path, tmp_path: Path):
    out = tmp_path / "bag"
    export_recording(run, "ros2", out=out)
    with pytest.raises(InputRefused, match="replace it with --force"):
        export_recording(run, "ros2", out=out)
    export_recording(run, "ros2", out=out, force=True)
    (out / "thesis.tex").write_text("years")
    with pytest.raises(InputRefused, match="not a bag written by twin"):
        export_recording(run, "ros2", out=out, force=True)
    assert (out / "thesis.tex").read_text() == "years"


@pytest.mark.parametrize("form", ["csv", "mat", "parquet", "ros2"])
def test_a_log_of_a_lab_is_exported_like_a_recording(tmp_path: Path, form):
    lab = bag(
        tmp_path / "lab",
        {
            "/j": [(0.01 * k, joints(0.01 * k, hip=0.1 * k, knee=0.2 * k)) for k in range(1, 20)],
            "/ft": [(0.02 * k, wrench(0.02 * k, 1.0 * k)) for k in range(1, 10)],
        },
    )
    maps = ["lab.F_z=/ft.wrench.force.z", "arm.q[0]=/j.position.hip", "arm.q[1]=/j.position.knee"]
    exported = export_recording(lab, form, out=tmp_path / "out", maps=maps)
    assert exported.signals == 2
    if form == "csv":
        head, first, *_ = (tmp_path / "out").read_text().splitlines()
        assert head == "t_s,lab.F_z_N,arm.q[0]_rad,arm.q[1]_rad"
        assert first == "0.02,1.0,0.2,0.4"
    if form == "ros2":
        log = read_log(tmp_path / "out", column_map([tmp_path / "out/map.toml"]))
        np.testing.assert_array_equal(log["arm.q[1]"].values, 0.2 * np.arange(1, 20))


@pytest.mark.parametrize(
    ("maps", "said"),
    [
        (["F=/ft.wrench.force.z"], "signal 'F' is not TOPIC.FIELD; name it like lab.F"),
        (["lab.F=/ft.wrench.force.z", "lab.q=/j.position.hip"], "lab.F and lab.q have other times"),
        ([], "choose with --map"),
    ],
)
def test_a_log_whose_signals_make_no_topics_is_refused(tmp_path: Path, maps: list[str], said: str):
    lab = bag(
        tmp_path / "lab",
        {
            "/j": [(0.01 * k, joints(0.01 * k, hip=0.1)) for k in range(1, 20)],
            "/ft": [(0.02 * k, wrench(0.02 * k, 1.0)) for k in range(1, 10)],
        },
    )
    with pytest.raises(LogError, match=said):
        export_recording(lab, "csv", maps=maps)


def test_a_recording_of_twin_needs_no_map(run: Path):
    with pytest.raises(InputRefused, match="whose names and units are known"):
        export_recording(run, "csv", maps=["a.b=c"])
