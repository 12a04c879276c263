from twin.studies.command import Steps


def test_each_step_says_which_it_is_and_how_much_is_over_before_it():
    heard: list[tuple[str, float | None]] = []
    steps = Steps(lambda what, share=None, /: heard.append((what, share)), 4)
    for name in "ab":
        steps.next(name)
    steps.share("b again", 0.5)
    assert heard == [("a, 1 of 4", 0.0), ("b, 2 of 4", 0.25), ("b again", 0.375)]


def test_a_step_too_many_is_never_more_than_all():
    heard: list[float | None] = []
    steps = Steps(lambda what, share=None, /: heard.append(share), 1)
    steps.next("a")
    steps.next("b")
    assert heard == [0.0, 1.0]
