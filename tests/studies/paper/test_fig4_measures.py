from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from tests.studies.paper.fig4_series import runs
from twin.kernel.recording.reader import Recording
from twin.studies.paper import fig4_figure as module
from twin.studies.paper.fig4_figure import FP_BASED, FP_REFERENCE, P_BASED, PRE_DEFINE, draw_fig4
from twin.studies.paper.fig4_measures import fig4_runs


def test_the_picture_shows_the_four_curves_in_the_papers_colours(
    force_position: Recording, position: Recording, tmp_path: Path
):
    draw_fig4(fig4_runs(force_position, position), tmp_path / "fig4.png")
    with Image.open(tmp_path / "fig4.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3)
    for color in (PRE_DEFINE, P_BASED, FP_BASED, FP_REFERENCE):
        rgb = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        # a curve across a panel is hundreds of pixels long; its core is not blended with the background
        assert np.count_nonzero(np.all(pixels == rgb, axis=1)) > 200, color


def test_the_curves_are_those_of_the_runs_in_mm_and_N_over_all_of_the_20_s(monkeypatch: pytest.MonkeyPatch):
    written, figure = runs(), Figure()
    monkeypatch.setattr(module, "picture", lambda *size: nullcontext(figure))
    draw_fig4(written, Path())
    fp, p = written.force_position, written.position
    height, force = ({str(line.get_label()): line.get_ydata() for line in axes.lines} for axes in figure.axes[:2])
    expected = {"Pre-define": fp.z_ref, "P-based": p.z, "F&P-based": fp.z, "F&P-based-ref": fp.z_cmd}
    for label, z in expected.items():
        np.testing.assert_array_equal(height[label], 1e3 * z)
    np.testing.assert_array_equal(force["P-based"], p.F_z)
    np.testing.assert_array_equal(force["F&P-based"], fp.F_z)
    assert all(axes.get_xlim() == (0.0, 20.0) for axes in figure.axes)


def test_panel_C_shows_the_imperfect_runs_or_says_which_it_needs(
    force_position: Recording, position: Recording, imperfect: tuple[Recording, Recording], tmp_path: Path
):
    shown = []
    for name, others in (("two.png", ()), ("four.png", imperfect)):
        draw_fig4(fig4_runs(force_position, position, *others), tmp_path / name)
        with Image.open(tmp_path / name) as picture:
            pixels = np.asarray(picture.convert("RGB"))
        # the lower left quarter
        panel = pixels[pixels.shape[0] // 2 :, : pixels.shape[1] // 2].reshape(-1, 3)
        rgb = [int(P_BASED[i : i + 2], 16) for i in (1, 3, 5)]
        shown.append(np.count_nonzero(np.all(panel == rgb, axis=1)))
    assert shown[0] == 0 and shown[1] > 200


def test_the_same_runs_give_the_same_picture(force_position: Recording, position: Recording, tmp_path: Path):
    runs = fig4_runs(force_position, position)
    for name in ("a.png", "b.png"):
        draw_fig4(runs, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
