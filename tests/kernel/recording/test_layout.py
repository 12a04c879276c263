import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from hypothesis import given

from twin.kernel.recording.layout import LARGEST_FIELD, Field, Topic, described_fields, descriptor_set, message_names

from .samples import DRIVE, ENCODER, PLANT, field_lists

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


TEMPERATURE = Field("T", 1, "double", "K", "winding temperature")


@given(field_lists)
def test_the_schema_alone_tells_name_size_kind_unit_and_meaning(fields: tuple[Field, ...]) -> None:
    assert described_fields("twin.Plant", descriptor_set("twin.Plant", fields)) == fields


def test_unit_and_meaning_are_the_comment_of_each_protobuf_field() -> None:
    file = FileDescriptorSet.FromString(descriptor_set("twin.Drive", DRIVE)).file[0]
    assert [location.leading_comments for location in file.source_code_info.location] == [
        "rad: motor angle",
        "rad/s: motor speed",
    ]


def test_topics_of_one_shape_share_a_message_type_and_others_do_not() -> None:
    topics = [Topic(f"drive/{leg}", DRIVE, 1) for leg in (1, 2, 3)]
    assert message_names([*topics, PLANT, ENCODER]) == ["twin.Drive"] * 3 + ["twin.Plant", "twin.Encoder"]


def test_a_drive_with_other_fields_has_a_message_type_of_its_own() -> None:
    odd = (*DRIVE, TEMPERATURE)
    topics = [Topic("drive/1", DRIVE, 1), Topic("drive/2", odd, 1), Topic("drive/3", DRIVE, 1)]
    assert message_names(topics) == ["twin.Drive", "twin.Drive2", "twin.Drive"]


def test_two_shapes_never_share_a_message_type() -> None:
    with pytest.raises(ValueError, match="topic Plant: type Plant has other fields already"):
        message_names([PLANT, Topic("Plant", DRIVE, 1)])


@pytest.mark.parametrize("name", ["twin.Drive", "twin.Plant"])
def test_a_schema_without_the_message_or_its_comments_is_refused(name: str) -> None:
    descriptors = FileDescriptorSet.FromString(descriptor_set("twin.Drive", DRIVE))
    descriptors.file[0].ClearField("source_code_info")
    with pytest.raises(ValueError, match=r"twin\.(Drive|Plant)"):
        described_fields(name, descriptors.SerializeToString())


def test_a_field_of_absurd_size_is_refused_before_memory_is_asked_for() -> None:
    for size, fits in ((LARGEST_FIELD, True), (LARGEST_FIELD + 1, False)):
        field = Field("x", size, "double", "1", "x")
        descriptors = descriptor_set("twin.X", [field])
        if fits:
            assert described_fields("twin.X", descriptors) == (field,)
            continue
        with pytest.raises(ValueError, match=r"field x of twin\.X is not one that twin writes"):
            described_fields("twin.X", descriptors)
