from tests.bytes.comparison import differences

TOPIC = {"messages": 20, "digest": "x", "seconds": "aaaaaaaabbbbbbbbcccccccc"}


def test_what_is_the_same_is_not_mentioned() -> None:
    came_to = {"text": "one\ntwo", "/plant": TOPIC}
    assert differences(came_to, dict(came_to)) == []


def test_the_first_second_in_which_a_topic_differs_is_named() -> None:
    other = TOPIC | {"digest": "y", "seconds": "aaaaaaaaddddddddcccccccc"}
    (said,) = differences({"/plant": TOPIC}, {"/plant": other})
    assert said == "/plant: 1 of 3 seconds differ, first from 1 s to 2 s"


def test_lines_of_a_text_that_differ_are_shown() -> None:
    (said,) = differences({"text": "one\ntwo\n"}, {"text": "one\n2\n"})
    assert "-two" in said and "+2" in said and "one" not in said


def test_what_only_one_tree_has_is_a_difference() -> None:
    assert differences({"/plant": TOPIC}, {}) == ["/plant: recorded in only one of the trees"]
    (said,) = differences({}, {"new.txt": "text"})
    assert "-nothing" in said and "+text" in said


def test_texts_that_differ_only_in_the_ends_of_their_lines_differ() -> None:
    assert differences({"text": "one\n"}, {"text": "one"}) == ["text: the ends of lines differ"]
