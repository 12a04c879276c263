from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D
from PIL import Image

from tests.studies.paper.fig5_recordings import pressed, pushed, rolled, tapped
from twin.kernel.recording.reader import Recording
from twin.studies.paper import fig5_figure
from twin.studies.paper.fig5 import Fig5Score, fig5_score, shown_tasks
from twin.studies.paper.fig5_figure import (
    ESTIMATE_COLOR,
    MOTION_COLOR,
    REFERENCE_COLOR,
    SHIFTED_COLOR,
    TRACE_COLOR,
    TRUTH_COLOR,
    draw_fig5,
)
from twin.studies.paper.study import fig5_result

MAKERS: dict[str, Callable[..., Recording]] = {"press": pressed, "tap": tapped, "roll": rolled, "push": pushed}


@pytest.fixture(scope="module")
def score(tmp_path_factory: pytest.TempPathFactory) -> Fig5Score:
    """One run of each kind."""
    return fig5_score([make(tmp_path_factory.mktemp(kind)) for kind, make in MAKERS.items()])


def test_the_picture_shows_truth_estimate_reference_trace_and_arrows(score: Fig5Score, tmp_path: Path):
    draw_fig5(score, tmp_path / "fig5.png")
    with Image.open(tmp_path / "fig5.png") as picture:
        assert picture.width >= 1500
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    for color in (TRUTH_COLOR, ESTIMATE_COLOR, SHIFTED_COLOR, REFERENCE_COLOR, TRACE_COLOR, MOTION_COLOR):
        rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        # an arrow is some 40 pixels long, a curve hundreds; their cores are not blended with the background
        assert np.count_nonzero(np.all(pixels == rgb, axis=1)) > 30, color


def test_panels_over_time_show_all_of_a_task_as_it_truly_was(score: Fig5Score, monkeypatch: pytest.MonkeyPatch):
    figure = Figure()
    monkeypatch.setattr(fig5_figure, "picture", lambda *size, **more: nullcontext(figure))
    draw_fig5(score, Path())
    columns = {task.kind: figure.axes[3 * k + 1 : 3 * k + 3] for k, task in enumerate(shown_tasks(score))}
    for task in shown_tasks(score):
        force = columns[task.kind][1]
        (true,) = (line for line in force.lines if line.get_label() == "true")
        if task.kind == "tap":
            # the last three of four
            assert force.get_xlim() == pytest.approx((0.5, 2.0), abs=0.01)
        else:
            assert force.get_xlim() == (task.run.t[0], task.run.t[-1])
            np.testing.assert_array_equal(true.get_ydata(), task.run.F_z)
    height = columns["press"][0]
    (true,) = (line for line in height.lines if line.get_label() == "true")
    np.testing.assert_array_equal(true.get_ydata(), 1e3 * score.tasks[0].run.p_B[:, 2])
    assert height.get_xlim() == columns["press"][1].get_xlim()


def test_the_time_that_is_judged_is_marked_in_all_but_taps(score: Fig5Score, monkeypatch: pytest.MonkeyPatch):
    figure = Figure()
    monkeypatch.setattr(fig5_figure, "picture", lambda *size, **more: nullcontext(figure))
    draw_fig5(score, Path())
    for k, task in enumerate(shown_tasks(score)):
        marks = [mark for mark in figure.axes[3 * k + 2].patches if mark.get_label() == "judged"]
        assert len(marks) == (task.kind != "tap")


def test_arrows_point_down_and_along_the_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    arrows: list[tuple[float, ...]] = []
    monkeypatch.setattr(Axes3D, "quiver", lambda axes, *place, **look: arrows.append(place[3:]))
    draw_fig5(fig5_score([pushed(tmp_path)]), tmp_path / "fig5.png")
    down, along = arrows
    assert down[:2] == (0.0, 0.0) and down[2] < 0.0
    # half of the line from (0, 0) to (4, 3) mm
    assert along == pytest.approx((2.0, 1.5, 0.0))


@pytest.mark.parametrize("kind", MAKERS)
def test_the_picture_of_one_task_has_its_axes_and_its_legend_whole(kind: str, tmp_path: Path):
    draw_fig5(fig5_score([MAKERS[kind](tmp_path)]), tmp_path / "fig5.png")
    with Image.open(tmp_path / "fig5.png") as picture:
        pixels = np.asarray(picture.convert("L"))
    # what is cut off ends at an edge
    edges = (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1])
    assert all(np.all(edge == 255) for edge in edges)


@pytest.mark.slow
def test_the_same_runs_give_the_same_picture(score: Fig5Score, tmp_path: Path):
    for name in ("a.png", "b.png"):
        draw_fig5(score, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_columns_stand_in_the_papers_order_whatever_the_order_of_the_runs(score: Fig5Score):
    backwards = Fig5Score(score.tasks[::-1], ())
    assert [task.kind for task in shown_tasks(backwards)] == ["press", "tap", "roll", "push"]


def test_a_run_that_tripped_before_it_did_anything_is_still_drawn(tmp_path: Path):
    draw_fig5(fig5_score([rolled(tmp_path, trip=0.1)]), tmp_path / "fig5.png")
    assert (tmp_path / "fig5.png").stat().st_size > 0


def test_of_many_runs_there_is_a_table_and_a_line_for_each_way_to_fail(tmp_path: Path):
    makers = [*MAKERS.values(), lambda folder: pressed(folder, aside=0.6e-3)]
    folders = [tmp_path / str(number) for number in range(len(makers))]
    for folder in folders:
        folder.mkdir()
    lines = fig5_result(fig5_score([make(at) for make, at in zip(makers, folders, strict=True)])).text.splitlines()
    assert max(map(len, lines)) <= 80
    # 0.601 of 0.5 mm
    assert next(line for line in lines if line.startswith("velocity_servo")).split()[2:5] == ["15/16", "120", "%"]
    assert sum(line.startswith("FAIL") for line in lines) == 1
    assert any(line.split()[:5] == ["FAIL", "scale", "press", "stays", "1"] for line in lines)
