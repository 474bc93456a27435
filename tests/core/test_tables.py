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


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"", "table.csv is empty; expected the columns x,y"),
        (b"# a\n# b\n\n", "table.csv is empty; expected the columns x,y"),
        (b"x,y\n", "table.csv has a header but no rows"),
        (b"x,y,x\n1,2,3\n", "table.csv names the column 'x' twice"),
        (b"x;y\n1;2\n", "table.csv has semicolons between its columns: save it with commas"),
        (b"x;y\n1,5;2\n", "table.csv has semicolons between its columns: save it with commas"),
        (b"x\n1\n", "table.csv lacks the column 'y'; expected x,y"),
        (b"x,y\n1\n", "table.csv line 2 has 1 values, but the header has 2 columns"),
        (b"x,y\n1,2,3\n", "table.csv line 2 has 3 values, but the header has 2 columns"),
        (b"x,y\n1,\x00\n", "table.csv line 2: y is '\\\\x00', not a number"),
        (b'x,y\n1,"2\n', "table.csv' cannot be read as CSV (unexpected end of data)"),
        ("x,y\n1,2\n".encode("utf-16"), "table.csv' cannot be read as text: it is in UTF-16: save it as UTF-8."),
    ],
)
def test_a_file_that_is_no_such_table_is_refused(tmp_path, content, named):
    path = tmp_path / "table.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as told:
        read_numbers(path, COLUMNS, name="path")
    assert named in str(told.value)


def test_what_is_no_file_is_named(tmp_path):
    for path, named in (
        (tmp_path / "none.csv", "^path: there is no file .*none"),
        (tmp_path, "^path: .* cannot be read: it is a directory"),
        (5, "^path must be the path of a file or a folder, got 5"),
    ):
        with pytest.raises(InputError, match=named):
            read_numbers(path, COLUMNS, name="path")


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
