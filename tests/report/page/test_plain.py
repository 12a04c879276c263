"""A sweep as a page: one file, no script, nothing from elsewhere, nothing taken for markup."""

import re
from pathlib import Path

import numpy as np
import pytest

from tests.studies.sweep.statistics.rows import kept, row
from twin.kernel.errors import InputRefused, NotWritten
from twin.report.page.plain import sweep_page, write_sweep_page
from twin.studies.sweep.claims import pack_curves
from twin.studies.sweep.show.parts import SweepQuery
from twin.studies.sweep.show.pictures import write_pictures
from twin.studies.sweep.stored import SweepRows

ASKED = SweepQuery("force_error_N", "lateral_error_mm", 5)


@pytest.fixture(scope="module")
def sweep() -> SweepRows:
    rows = [
        row(n, {"a<b>": float(n % 4), "c": float(n // 4)}, force_error_N=1.0 + n % 4, lateral_error_mm=9.0 - n % 4)
        for n in range(12)
    ]
    return kept([*rows, row(12, {"a<b>": 0.0, "c": 3.0})])


@pytest.fixture(scope="module")
def pictures(sweep: SweepRows, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_pictures(sweep, ASKED, None, None, tmp_path_factory.mktemp("pictures"))


def test_it_holds_every_part_and_every_picture_inside_itself(sweep: SweepRows, pictures: dict[str, Path]):
    html = sweep_page(sweep, ASKED, pictures)
    for text in ("Best runs by force_error_N", "Rank correlation with", "Pareto front of", "Each metric", "it crashed"):
        assert text in html
    assert html.count('src="data:image/png;base64,') == len(pictures) == 3
    assert not re.search(r"<script|https?://|\$[a-z]", html)
    assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:" in html


def test_names_from_the_sweep_file_are_no_markup(sweep: SweepRows, pictures: dict[str, Path]):
    html = sweep_page(sweep, ASKED, pictures)
    assert "a&lt;b&gt;" in html and "a<b>" not in html


def test_every_link_of_the_contents_leads_somewhere(sweep: SweepRows, pictures: dict[str, Path]):
    html = sweep_page(sweep, ASKED, pictures)
    links = re.findall(r'href="#([^"]+)"', html)
    assert len(links) > 5 and all(f'id="{link}"' in html for link in links)


def test_the_same_rows_make_the_same_bytes(sweep: SweepRows, pictures: dict[str, Path], tmp_path: Path):
    again = write_pictures(sweep, ASKED, None, None, tmp_path)
    assert sweep_page(sweep, ASKED, again) == sweep_page(sweep, ASKED, pictures)


def test_a_folder_that_cannot_be_written_is_told(sweep: SweepRows, tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(NotWritten, match=r"sweep\.html: cannot be written"):
        write_sweep_page(sweep, ASKED, {}, tmp_path / "file")


def test_a_parameter_that_does_not_vary_is_on_no_map(sweep: SweepRows, tmp_path: Path):
    with pytest.raises(InputRefused, match="--x d: no number that varies here"):
        write_pictures(sweep, ASKED, "d", None, tmp_path)


def test_claims_are_explained_and_their_bands_drawn_beside_them(tmp_path: Path):
    t = np.linspace(0.0, 19.9, 200)
    of_one = ("z", "true_z", "F_z", "true_F_z", "F_x", "F_y")
    names = [f"{run}.{one}" for run in ("force_position", "position") for one in of_one]
    rows = [
        {
            **row(n, {"a": float(n), "b": float(-n)}, force_error_N=1.0 + n),
            "claims": {"trigger_time": {"value": 5.6, "verdict": "holds"}},
            "curves": pack_curves({name: (t, n * np.sin(t)) for name in [*names, "force_position.z_cmd"]}, 19.9),
        }
        for n in range(1, 9)
    ]
    drawn = write_pictures(kept(rows), ASKED, None, None, tmp_path)
    # nothing that varies is anyone's choice, so there is no map and no front
    assert set(drawn) == {"bands", "metrics"}
    html = sweep_page(kept(rows), ASKED, drawn)
    claims = html.split('<section id="claims-0"')[1].split("</section>")[0]
    assert "force control triggers near 5.6 s" in claims and "Fig. 4 over all runs" in claims
