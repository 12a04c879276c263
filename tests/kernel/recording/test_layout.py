import pytest

from twin.kernel.recording.layout import Field, Topic

F_Z = Field("F_z", 1, "double", "N", "pressing force")


@pytest.mark.parametrize("name", ["", "1st", "p B", "p-B", "p.B", "_p"])
def test_a_field_name_that_protobuf_cannot_hold_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="field name"):
        Field(name, 1, "double", "m", "position")


def test_a_field_without_values_is_refused() -> None:
    with pytest.raises(ValueError, match="size is 0, expected 1 or more"):
        Field("p_B", 0, "double", "m", "position")


def test_a_kind_that_no_message_has_is_refused() -> None:
    with pytest.raises(ValueError, match="kind is 'float', expected one of"):
        Field("p_B", 3, "float", "m", "position")  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["", "/plant", "drive//1", "drive/", "drive.1"])
def test_a_topic_name_with_empty_words_or_dots_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match="topic name"):
        Topic(name, (F_Z,), 1)


def test_a_topic_that_never_comes_round_is_refused() -> None:
    with pytest.raises(ValueError, match="period is 0 ticks"):
        Topic("scale", (F_Z,), 0)


@pytest.mark.parametrize("fields", [(), (F_Z, F_Z)])
def test_a_topic_needs_fields_of_different_names(fields: tuple[Field, ...]) -> None:
    with pytest.raises(ValueError, match="fields of different names"):
        Topic("scale", fields, 1)
