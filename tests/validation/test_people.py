"""Bodies that are unlike people are outside, and the page says of the bodies what they are."""

import re
from pathlib import Path

import pytest

from validation import people
from validation.people import REGIONS, body, cells, depth_at, force, pressure
from validation.yardstick import NotHere, Yardstick
from validation.yardsticks import people as yardsticks

READ = [one for one in yardsticks.YARDSTICKS if one.reason != yardsticks.UNREAD]
SIZES, BELLY, RATE, LIFT, COLLISION, SPINE, PAIN = READ


def worst(yardstick: Yardstick) -> float:
    return max(yardstick.differences().values())


def test_all_bodies_are_where_the_rows_say():
    for one in READ:
        assert worst(one) <= one.bound


@pytest.mark.parametrize(("row", "changes"), [(SIZES, {"radius": 0.130}), (BELLY, {"radius": 0.3})])
def test_a_body_of_another_size_is_outside(row: Yardstick, changes: dict[str, float], monkeypatch: pytest.MonkeyPatch):
    right = body
    monkeypatch.setattr(people, "body", lambda name: (right(name)[0].model_copy(update=changes), right(name)[1]))
    assert worst(row) > 0.0


@pytest.mark.parametrize(("row", "changes"), [(RATE, {"rate": 0.4}), (LIFT, {"amplitude": 0.0019})])
def test_another_breath_is_outside(row: Yardstick, changes: dict[str, float], monkeypatch: pytest.MonkeyPatch):
    right = body

    def breathing(name: str):
        contact, parameters = right(name)
        breath = contact.breathing and contact.breathing.model_copy(update=changes)
        return contact.model_copy(update={"breathing": breath}), parameters

    monkeypatch.setattr(people, "body", breathing)
    assert worst(row) > row.bound


def test_a_belly_that_lifts_as_people_do_is_inside(monkeypatch: pytest.MonkeyPatch):
    contact, parameters = body("belly")
    assert contact.breathing is not None
    breath = contact.breathing.model_copy(update={"amplitude": 0.0055})
    monkeypatch.setattr(people, "body", lambda name: (contact.model_copy(update={"breathing": breath}), parameters))
    assert worst(LIFT) == 0.0


def test_stiffer_bodies_and_a_smaller_head_are_outside(monkeypatch: pytest.MonkeyPatch):
    right = people.stiffness_at
    monkeypatch.setattr(people, "stiffness_at", lambda name, held: 25.0 * right(name, held))
    assert worst(COLLISION) > 0.0 and worst(SPINE) > 0.0
    monkeypatch.setattr(people, "HEAD", 0.007)
    assert worst(PAIN) > 0.0


def test_what_could_not_be_read_is_not_run():
    unread = [one for one in yardsticks.YARDSTICKS if one not in READ]
    assert unread
    for one in unread:
        with pytest.raises(NotHere, match="no number is taken"):
            one.differences()


@pytest.mark.parametrize("name", REGIONS)
def test_the_page_has_each_body_s_curve(name: str, root: Path):
    page = (root / "docs" / "bodies.md").read_text()
    assert f"| {' | '.join(cells(name))} |" in page
    assert force(name, depth_at(name, 5.0)) == pytest.approx(5.0, rel=1e-9)


def test_the_page_has_the_pressures_and_ranges_of_the_rows(root: Path):
    page = (root / "docs" / "bodies.md").read_text()
    assert f"{1e-3 * pressure(15.0):.0f} kPa, 8 N are {1e-3 * pressure(8.0):.0f} kPa" in page
    for name, (low, high) in yardsticks.RADII.items():
        contact, _ = body(name)
        assert contact.radius is not None
        circumference = 2e3 * 3.141592653589793 * contact.radius
        row = next(line for line in page.splitlines() if line.startswith("|") and f"{circumference:.0f} mm" in line)
        printed = [float(number) for number in re.findall(r"(\d+) to (\d+) mm", row)[0]]
        # printed to whole millimetres, the radii to tenths
        assert printed == pytest.approx([6.283185 * low, 6.283185 * high], abs=0.9)
    assert "{:g} to {:.1f} mm".format(*yardsticks.LIFT) in page


def test_the_picture_is_drawn(tmp_path: Path):
    people.draw(tmp_path / "bodies.png")
    assert (tmp_path / "bodies.png").stat().st_size > 20_000
