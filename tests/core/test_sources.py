import sys
from types import ModuleType

import numba
import numpy as np
import pytest
from numba.core.caching import NullCache
from support.small import problem

import lmd
from lmd.core import compiled, sources
from lmd.core.compile_clock import TimedCompiler
from lmd.core.compiled import LINKED
from lmd.core.sources import classes_in, digest_of
from lmd.incremental.coverage_field import CoverageField
from lmd.incremental.field import Places
from lmd.objectives.coverage import Threshold
from lmd.objectives.localisation.field import LocalisationField
from lmd.optimisers.annealing import surrogate
from lmd.optimisers.annealing.walk import walk
from lmd.sight import kernels
from lmd.sight.kernels import evaluate_range
from lmd.sight.models.fiducial_sight import FiducialSight
from lmd.sight.models.paper import PaperSight

PARTS = """
SIZE = 3
def half(x):
    return x / SIZE
"""
OTHER = """
def unused(x):
    return x
"""
KERNEL = """
import math
import parts
from parts import half
TABLE = (1.0, 2.0)
def work(x):
    return half(x) + math.sqrt(TABLE[0]) + parts.half(x)
"""


@pytest.fixture
def digest(tmp_path, monkeypatch):
    """The digest of a kernel whose modules have some text."""
    monkeypatch.syspath_prepend(tmp_path)

    def read(**texts):
        for name, text in {"parts": PARTS, "other": OTHER, "work": KERNEL, **texts}.items():
            (tmp_path / f"{name}.py").write_text(text)
            sys.modules.pop(name, None)
            module = ModuleType(name)
            module.__file__ = str(tmp_path / f"{name}.py")
            sys.modules[name] = module
            exec(compile(text, module.__file__, "exec"), module.__dict__)
        sources._source_of.cache_clear()
        return digest_of(sys.modules["work"].work, ())

    yield read
    for name in ("parts", "other", "work"):
        sys.modules.pop(name, None)
    sources._source_of.cache_clear()


def test_the_digest_is_that_of_what_a_kernel_calls(digest):
    before = digest()
    assert digest() == before
    assert digest(other=OTHER + "# changed") == before
    changed = [digest(parts=PARTS + "# changed"), digest(work=KERNEL + "# changed")]
    changed += [digest(parts=PARTS.replace("3", "4")), digest(work=KERNEL.replace("2.0", "3.0"))]
    assert len({before, *changed}) == 5
    assert digest() == before


MODULES = {
    "default": ("def work(x, factor=SIZE):\n    return x * factor\n", "from parts import SIZE\n"),
    "a tuple of functions": ("def work(x):\n    return ALL[0](x)\n", "from parts import half\nALL = (half,)\n"),
    "a module of a module": ("def work(x):\n    return package.parts.half(x)\n", "import package\n"),
}


@pytest.mark.parametrize("case", MODULES)
def test_the_digest_has_what_is_named_in_other_ways(case, digest, monkeypatch):
    body, head = MODULES[case]

    def read(**texts):
        package = ModuleType("package")
        monkeypatch.setitem(sys.modules, "package", package)
        digest(**texts)
        package.parts = sys.modules["parts"]
        return digest(work=head + body, **texts)

    before = read()
    assert read(other=OTHER + "# changed") == before
    assert read(parts=PARTS.replace("3", "4")) != before


def test_the_order_of_constants_counts(digest):
    work = "from parts import PAIR\ndef work(x):\n    return PAIR[0] * x\n"
    assert digest(parts="PAIR = (1, 2)\n", work=work) != digest(parts="PAIR = (2, 1)\n", work=work)


def test_code_that_was_edited_after_it_was_loaded_has_another_digest(digest, tmp_path):
    before = digest()
    path = tmp_path / "parts.py"
    path.write_text(PARTS.replace("3", "4"))
    sources._source_of.cache_clear()
    loaded_before = digest_of(sys.modules["work"].work, ())
    assert len({before, loaded_before, digest(parts=PARTS.replace("3", "4"))}) == 3


def test_what_is_in_no_file_has_no_digest():
    space = {"__name__": "nowhere"}
    exec("def work(x): return x", space)
    assert digest_of(space["work"], ()) is None


def module_names(kernel, classes):
    """The modules whose files a digest covers."""
    read = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sources, "_source_of", lambda module: read.append(module) or b"")
        digest_of(kernel.py_func, classes)
    return set(read)


def test_an_edit_makes_those_kernels_stale_that_it_is_a_part_of():
    paper = module_names(walk, {CoverageField, Threshold, PaperSight})
    tags = module_names(walk, {CoverageField, LocalisationField, FiducialSight})
    evaluated = module_names(evaluate_range, {PaperSight})
    assert {"lmd.optimisers.annealing.walk", "lmd.incremental.trial"} <= paper
    assert {"lmd.sight.models.paper", "lmd.objectives.coverage", "lmd.core.bits"} <= paper
    assert {"lmd.objectives.localisation.trial", "lmd.sight.models.fiducial_sight"} <= tags - paper
    assert "lmd.optimisers.annealing.walk" not in evaluated
    assert not {name for name in evaluated if name.startswith(("lmd.incremental", "lmd.objectives"))}
    assert "lmd.planner.figures" not in paper | tags | evaluated


@pytest.mark.skipif(not LINKED, reason="numba's libraries know what they are linked with")
@pytest.mark.parametrize(
    ("user", "name"),
    [
        (kernels, "evaluate_range"),
        pytest.param(surrogate, "walk", marks=pytest.mark.thorough("lmd/core")),
    ],
)
def test_all_functions_that_are_compiled_for_a_kernel_are_in_its_digest(user, name, monkeypatch):
    """Compiles the kernel for a small problem, with those inner functions that this process has not compiled yet.

    It takes 4 s, the walk 15 s.
    """
    kernel = compiled.kernel(getattr(user, name).py_func)
    monkeypatch.setattr(user, name, kernel)
    functions, within, compiles = set(), [], TimedCompiler.compile_extra

    def noted(self, func):
        within.append(func)
        if within[0] is kernel.py_func:
            functions.add(func)
        result = compiles(self, func)
        within.pop()
        return result

    monkeypatch.setattr(TimedCompiler, "compile_extra", noted)
    monkeypatch.setattr(kernel, "_cache", NullCache())
    lmd.optimise(problem(), evaluations=31)
    classes = {kind for signature in kernel.signatures for kind in classes_in(signature)}
    own = {function.__module__ for function in functions if (function.__module__ or "").startswith("lmd.")}
    assert own
    assert own <= module_names(kernel, classes)


def test_classes_are_found_in_tuples_of_named_tuples():
    kind = numba.typeof((Places(np.zeros((6, 1)), np.zeros(1)), (1, 2.0)))
    assert classes_in([kind, numba.float64]) == {Places}
