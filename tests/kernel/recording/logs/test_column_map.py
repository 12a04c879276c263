from pathlib import Path

import pytest

from twin.kernel.recording.logs.column_map import column_map, require_unit, split_unit
from twin.kernel.recording.logs.log import LogError, MappedColumn


def test_file_and_command_line_say_the_same(tmp_path: Path):
    file = tmp_path / "map.toml"
    file.write_text(
        'time = { column = "stamp", unit = "ms" }\n'
        'controller.F_z = { column = "Fz", unit = "N", sign = -1 }\n'
        '"plant.p_B[2]" = "z_mm"\n'
        '"encoder.theta[0]" = "/joints.position[0][deg]"\n'
    )
    texts = [
        "time=stamp[ms]",
        "controller.F_z=-Fz[N]",
        "plant.p_B[2]=z_mm",
        "encoder.theta[0]=/joints.position[0][deg]",
    ]
    assert column_map([str(file)]) == column_map(texts)
    assert column_map(texts) == {
        "time": MappedColumn("stamp", "ms"),
        "controller.F_z": MappedColumn("Fz", "N", -1),
        "plant.p_B[2]": MappedColumn("z_mm"),
        "encoder.theta[0]": MappedColumn("/joints.position[0]", "deg"),
    }


def test_later_entries_win(tmp_path: Path):
    file = tmp_path / "map.toml"
    file.write_text('F = "a"\nG = "b"\n')
    assert column_map([file, "F=c[N]"]) == {"F": MappedColumn("c", "N"), "G": MappedColumn("b")}


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("F_z_N", "F_z", "N"),
        ("F_z [N]", "F_z", "N"),
        ("F_z (N m)", "F_z", "N m"),
        ("omega_m_rad_per_s", "omega_m", "rad_per_s"),
        ("plant.tau_l[0]_N_m", "plant.tau_l[0]", "N_m"),
        ("k_s_N_m_per_rad", "k_s", "N_m_per_rad"),
        ("plant.p_B[2]_mm", "plant.p_B[2]", "mm"),
        ("position[2]", "position[2]", ""),
        ("position[2] [rad]", "position[2]", "rad"),
        ("theta_m_deg", "theta_m", "deg"),
        ("theta_m", "theta_m", ""),
        ("encoder.count_m", "encoder.count_m", ""),
        ("controller.F_z", "controller.F_z", ""),
        ("t_s", "t", "s"),
        ("N", "N", ""),
    ],
)
def test_a_head_carries_its_unit_as_a_toml_key_does_or_in_brackets(header: str, name: str, unit: str):
    assert split_unit(header) == (name, unit)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ('F = { colum = "Fz" }', "F: unknown key 'colum'; known are column, unit, sign"),
        ('F = { column = "Fz", sign = 2 }', "F: sign = 2: expected 1 or -1"),
        ('F = { column = "Fz", unit = 1 }', "F: unit = 1: expected text in quotes"),
        ('F = { unit = "N" }', 'F: expected column = "COLUMN"'),
        ("F = 3", "F = 3: expected"),
        ("F = {", "not valid TOML"),
        ("# nothing\n", "an empty map"),
    ],
)
def test_a_wrong_entry_of_a_file_is_refused_with_its_place(tmp_path: Path, content: str, expected: str):
    file = tmp_path / "map.toml"
    file.write_text(content)
    with pytest.raises(LogError) as refused:
        column_map([file])
    assert str(refused.value).startswith(f"{file}: ")
    assert expected in str(refused.value)


def test_every_wrong_text_is_told_at_once():
    with pytest.raises(LogError) as refused:
        column_map(["=x", "F=", "nowhere.toml"])
    assert len(str(refused.value).splitlines()) == 3


def test_an_unknown_unit_is_refused_with_the_nearest():
    with pytest.raises(LogError, match=r"a.csv: column 'F': unknown unit 'kgff'; did you mean 'kgf'\?"):
        require_unit("kgff", "a.csv: column 'F'")
