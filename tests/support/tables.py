"""Tables beside tests: rows of values, and of what is refused."""

from pathlib import Path
from pkgutil import resolve_name

import pytest
import yaml

from lmd.core.checks import InputError


def rows(test_file, name):
    """Rows of a table in `rows.yaml` beside a test file."""
    return yaml.safe_load(Path(test_file).with_name("rows.yaml").read_text(encoding="utf-8"))[name]


def refusals(test_file, **calls):
    """A test of each row of `refused.yaml` beside a test file.

    The table has rows `[arguments, regular expression]` by what is called: a name in `calls`, or a dotted one of the
    library. Of named arguments a `text` is written to a file, whose path comes first; without others the sentence names
    that file, which may be `called` something. With no file it names the argument that the error has.
    """
    table = yaml.safe_load(Path(test_file).with_name("refused.yaml").read_text(encoding="utf-8"))
    every = [pytest.param(of, *row, id=f"{of}: {row[1][:60]}") for of, own in table.items() for row in own]

    @pytest.mark.parametrize(("of", "given", "sentence"), every)
    def refuses(of, given, sentence, write):
        named = dict(given) if isinstance(given, dict) else {}
        path = [write(named.pop("text"), named.pop("called", "table.csv"))] if "text" in named else []
        call = calls[of] if of in calls else resolve_name(of)
        with pytest.raises(InputError, match=sentence) as refused:
            call(*path, *([] if isinstance(given, dict) else given), **named)
        message = str(refused.value)
        assert "\n" not in message
        assert path or (refused.value.argument or "") in message
        assert named or all(Path(one).name in message for one in path)

    return refuses
