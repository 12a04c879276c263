"""How pictures look.

Pictures for a paper have the width of its columns, its letters and lines, and stand beside those for the screen.
"""

import os
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib import colormaps, rc_context, rcParams
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

from tests.command_line import twin_process
from twin.studies.analyse.pictures import DAMPING_SHADES
from twin.studies.figure import COLUMN_WIDTHS, FONT_SIZE, LESS_IS_BETTER, for_paper, picture


def lightness(color: object) -> float:
    """Relative luminance, ITU-R BT.709."""
    return float(np.dot(to_rgb(color), (0.2126, 0.7152, 0.0722)))  # type: ignore[arg-type]


def test_in_every_map_light_is_good():
    errors = [lightness(color) for color in colormaps[LESS_IS_BETTER](np.linspace(0.0, 1.0, 20))[:, :3]]
    assert errors == sorted(errors, reverse=True)
    # from hardly damped to well damped
    damping = [lightness(color) for color in DAMPING_SHADES]
    assert damping == sorted(damping)


def drawn(path: Path) -> Figure:
    with picture(path, 12, 7.5, "title") as figure:
        for axes in figure.subplots(2, 2).ravel():
            axes.plot([0, 1], [0, 1], lw=2.2, label="a")
            axes.plot([0, 1], [1, 0], lw=0.7, label="b")
            axes.legend()
    return figure


def test_nothing_more_is_written_unless_it_is_asked_for(tmp_path: Path):
    drawn(tmp_path / "a.png")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]


@pytest.mark.parametrize("columns", [1, 2])
def test_a_picture_fills_the_columns_and_has_one_size_of_letters_and_two_weights(tmp_path: Path, columns: int):
    with for_paper(["svg", "pdf"], columns) as paper:
        figure = drawn(tmp_path / "a.png")
    assert paper.written == [tmp_path / "a.svg", tmp_path / "a.pdf"]
    width = re.search(r'width="([\d.]+)pt"', (tmp_path / "a.svg").read_text())
    assert width and float(width[1]) == pytest.approx(72.0 * COLUMN_WIDTHS[columns], abs=0.1)
    for axes in figure.axes:
        assert [line.get_linewidth() for line in axes.lines] == [1.0, 0.6]
        legend = axes.get_legend()
        assert legend and {text.get_fontsize() for text in legend.get_texts()} == {FONT_SIZE}
    lefts = {round(axes.get_position().x0, 2) for axes in figure.axes}
    assert len(lefts) == columns


@pytest.mark.slow
def test_the_same_picture_has_the_same_bytes(tmp_path: Path):
    found = []
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        with for_paper(["svg", "pdf"]):
            drawn(tmp_path / name / "x.png")
        found.append([(tmp_path / name / f"x.{form}").read_bytes() for form in ("png", "svg", "pdf")])
    assert found[0] == found[1]


def test_the_picture_for_the_screen_is_what_it_is_without(tmp_path: Path):
    drawn(tmp_path / "a.png")
    with for_paper(["svg"]):
        drawn(tmp_path / "b.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_the_settings_of_the_user_change_no_picture(tmp_path: Path):
    with picture(tmp_path / "a.png", 4, 3, "title") as figure:
        figure.subplots().plot([0, 1], [0, 1])
    own = {
        "text.usetex": True,
        "font.family": "NoSuchFont",
        "lines.linewidth": 9.0,
        "savefig.dpi": 30,
        "axes.grid": False,
    }
    with rc_context(own):  # type: ignore[arg-type]
        with picture(tmp_path / "b.png", 4, 3, "title") as figure:
            figure.subplots().plot([0, 1], [0, 1])
        assert rcParams["lines.linewidth"] == 9.0
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


SETTINGS = "text.usetex: True\nfont.family: NoSuchFont\nbackend: no_such\naxes.titlesize: 40\n"


@pytest.mark.parametrize("where", ["of the folder", "of the environment"])
def test_a_command_draws_the_same_in_a_notebook_and_beside_a_matplotlibrc(tmp_path: Path, where: str):
    rows = "t_s,F_z_N\n" + "".join(f"{k / 100},{k % 7}\n" for k in range(200))
    own = {**os.environ, "MPLBACKEND": "module://no_such.backend", "MATPLOTLIBRC": str(tmp_path / "settings")}
    drawn = []
    for name in ("plain", "own"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "a.csv").write_text(rows)
        (folder / "b.csv").write_text(rows.replace(",3\n", ",4\n"))
        if name == "own":
            (folder / "matplotlibrc" if where == "of the folder" else tmp_path / "settings").write_text(SETTINGS)
        command = ["compare", "a.csv", "b.csv", "--tol", "10N", "--out", "out"]
        done = twin_process(*command, cwd=folder, env=own if name == "own" else None)
        assert done.returncode == 0, done.stderr
        drawn.append((folder / "out" / "compare.png").read_bytes())
    assert drawn[0] == drawn[1]
