"""The suite: frozen problems, as functions on the unit box, for optimisers of any library.

The definition of a frozen problem does not change.

    >>> import lmd.suite
    >>> problem = lmd.suite.problem("lab_localisation")
    >>> problem.dim
    48
    >>> start = problem.start(seed=0)
    >>> bool(problem(start) == problem(start[None])[0])
    True

`lmd.suite.BlackBox(problem)` converts any `lmd.Problem` to such a function.
"""

from lmd.suite.adapters import pymoo_problem
from lmd.suite.black_box import BlackBox
from lmd.suite.documents import Document, document, names
from lmd.suite.frozen import problem
from lmd.suite.records import best, verify

__all__ = ["BlackBox", "Document", "best", "document", "names", "problem", "pymoo_problem", "verify"]
