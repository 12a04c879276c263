from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from twin.experiment.source import Source, read_source
from twin.experiment.written import source_text

# a lone surrogate is no text in any encoding
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
PLAIN = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False, allow_infinity=False), TEXTS
)
KEYS = st.text('abcXYZ_-é" ', min_size=1, max_size=6)
VALUES = st.one_of(PLAIN, st.lists(PLAIN, max_size=3), st.lists(st.lists(PLAIN, max_size=2), max_size=2))
TABLES = st.dictionaries(KEYS, VALUES, max_size=3)
FILES = st.dictionaries(KEYS, st.one_of(VALUES, TABLES, st.lists(TABLES, min_size=1, max_size=3)), max_size=5)


@given(FILES, TEXTS)
def test_what_is_written_is_read_as_it_was_with_its_origins_and_order(tmp_path_factory, table: dict, origin: str):
    source = Source()
    source.put(table, origin)
    path: Path = tmp_path_factory.getbasetemp() / "written.toml"
    path.write_text(source_text(source), encoding="utf-8", newline="")
    again = read_source(path)
    # repr tells 1 from 1.0 and True, and orders
    assert repr(again) == repr(source)
