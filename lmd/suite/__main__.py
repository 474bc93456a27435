"""Command that scores solutions of the suite's problems: `python -m lmd.suite ENTRY.yaml ...`.

Each ENTRY.yaml contains a solution (`lmd.suite.records`); the command prints the file's data and the score as YAML.
"""

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
