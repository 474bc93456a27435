"""Refusals as rows of a table: what refuses, its arguments, and the sentence."""

from pathlib import Path
from pkgutil import resolve_name

import pytest
import yaml

from lmd.core.checks import InputError


def refusals(test_file, **calls):
    """A test of each row of `refused.yaml` beside a test file.

    The table has rows `[arguments, regular expression]` by what is called: a name in `calls`, or a dotted one of the
    library. Of named arguments a `text` is written to a file, whose path comes first; without others the sentence names
    that file, which may be `called` something. With no file it names the argument that the error has.
    """
    table = yaml.safe_load(Path(test_file).with_name("refused.yaml").read_text(encoding="utf-8"))
    rows = [pytest.param(of, *row, id=f"{of}: {row[1][:60]}") for of, own in table.items() for row in own]

    @pytest.mark.parametrize(("of", "given", "sentence"), rows)
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
