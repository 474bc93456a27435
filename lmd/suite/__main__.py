"""Score entries to the suite: `python -m lmd.suite ENTRY.yaml ...` prints the record of each entry as YAML."""

import sys

import yaml

from lmd.core.checks import InputError
from lmd.suite.records import verify

if __name__ == "__main__":
    try:
        if not sys.argv[1:]:
            raise InputError("name the file of an entry: python -m lmd.suite ENTRY.yaml.")
        for path in sys.argv[1:]:
            print(yaml.safe_dump(verify(path), sort_keys=False, allow_unicode=True), end="")
    except InputError as error:
        sys.exit(f"error: {error}")
