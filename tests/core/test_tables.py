import numpy as np
import pandas as pd
import pytest

from lmd.core.checks import InputError
from lmd.core.tables import read_numbers, read_table, write_table

COLUMNS = ("x", "y")


def test_comments_and_blank_lines_are_left_out_and_lines_keep_their_numbers(write):
    path = write("# measured by hand\n\nx,y\n  # the first\n1,2\n\n3,4\n# end\n")
    assert read_numbers(path, COLUMNS, name="path").tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert read_table(path, name="path").lines == [5, 7]
    with pytest.raises(InputError, match=r"table\.csv line 3: y is '4 # no', not a number"):
        read_numbers(write("x,y\n# a\n3,4 # no\n"), COLUMNS, name="path")


def test_texts_may_be_quoted_and_hold_a_hash(write):
    table = read_table(write('x,note\n1,"left, above #3"\n2, #4 is next\n3,"a\x1b[2J\nb\u202e\xa0c\té"\n'), name="path")
    assert table.texts["note"] == ["left, above #3", "#4 is next", "a\\x1b[2J\\nb\\u202e\xa0c\té"]
    assert table.numbers(["x"], None).tolist() == [[1.0], [2.0], [3.0]]


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_file_may_begin_with_a_mark_of_its_encoding_and_have_any_ends_of_lines(tmp_path, end):
    path = tmp_path / "table.csv"
    path.write_bytes(b"\xef\xbb\xbf" + end.join(["x, y", "1, 2", ""]).encode())
    np.testing.assert_array_equal(read_numbers(path, COLUMNS, name="path"), [[1.0, 2.0]])


def test_a_file_in_another_encoding_is_refused(tmp_path):
    (tmp_path / "table.csv").write_bytes("x,y\n1,2\n".encode("utf-16"))
    with pytest.raises(InputError, match=r"table\.csv' cannot be read as text: it is in UTF-16: save it as UTF-8\."):
        read_numbers(tmp_path / "table.csv", COLUMNS, name="path")


def test_a_table_is_not_as_wide_as_it_is_long(write):
    path = write(",".join(map(str, range(100_000))))
    with pytest.raises(
        InputError, match=r"table\.csv has 100000 columns, more than 1000; the first line is its header"
    ):
        read_numbers(path, COLUMNS, name="path")


def test_what_is_written_is_what_pandas_writes(tmp_path):
    columns = {
        "id": np.arange(3),
        "mixed": [1, 2.5, 3],
        "x": np.array([0.1 + 0.2, np.nan, -np.inf]),
        "note": ["left, above", 'a "quote"', ""],
    }
    write_table(tmp_path / "ours.csv", columns)
    pd.DataFrame(columns).to_csv(tmp_path / "theirs.csv", index=False)
    assert (tmp_path / "ours.csv").read_bytes() == (tmp_path / "theirs.csv").read_bytes()
