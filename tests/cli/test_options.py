"""Options that several commands share."""

import pytest
from twin.cli.options import as_spelt_now


@pytest.mark.parametrize(
    ("words", "now"),
    [
        ("", ""),
        ("tune x.toml --no-isolate", "tune x.toml --isolate=none"),
        ("tune --isolate x.toml", "tune --isolate=run x.toml"),
        ("tune x.toml --isolate", "tune x.toml --isolate=run"),
        ("tune x.toml --isolate none", "tune x.toml --isolate none"),
        ("run x.toml --isolate drive", "run x.toml --isolate drive"),
        ("run x.toml --isolate=drive", "run x.toml --isolate=drive"),
    ],
)
def test_the_ways_in_which_isolation_was_once_asked_for_still_work(words: str, now: str):
    assert as_spelt_now(words.split()) == now.split()
