"""Tables as models read them."""

from twin.experiment.mistakes import checked
from twin.settings import Settings


class Made(Settings):
    count: int = 0
    share: float = 0.0


def test_tables_that_are_written_alike_are_one_and_others_are_not():
    mistakes: list[str] = []
    zero, same, negative = (checked(Made, {"share": share}, "made", mistakes) for share in (0.0, 0.0, -0.0))
    assert zero is same and str(zero) != str(negative)
    # equal in Python, and to TOML a whole number, another number and a truth value
    for said in (1, 1.0, True):
        checked(Made, {"count": said}, "made", mistakes)
    assert mistakes == [
        "[made] count = 1.0: expected a whole number",
        "[made] count = true: expected a whole number",
    ]
