"""Weigh the project: `python benchmarks/weight.py [FOLDER]`.

Prints Markdown tables: the amounts that `tests/test_weight.py` limits; files, lines and code lines of each package;
modules that a single module of their package imports; public names with more than one definition; counts of phrases
that the style forbids. `--page` writes the tables to docs/results/weight.md.

A code line holds a token of a statement that is neither a docstring nor an import. A key of the configuration is a
value in `conf`, apart from `_target_`, `_partial_`, lists of defaults and settings of Hydra.
"""

import argparse
import ast
import contextlib
import io
import re
import tokenize
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parents[1]
SOURCES = ("lmd", "pipelines")
QUESTION = re.compile(r"(What|How|Whether|Where|Who|Which)\b")
TICS = {
    "docstring begins with What, How, Whether, Where, Who or Which": None,
    "so many, so far, so much": re.compile(r"\bso (many|far|much)\b", re.IGNORECASE),
    "the same, without a noun": re.compile(
        r"\bthe same(?=[.,;:)]|$| (as|for|of|in|with|by|at)\b)", re.IGNORECASE | re.MULTILINE
    ),
    "nobody, whoever, whatever": re.compile(r"\b(nobody|whoever|whatever)\b", re.IGNORECASE),
    "what it is of": re.compile(r"\bwhat (it|they|that|each) (is|are|has|have) (of|by|from|to)\b", re.IGNORECASE),
}
PAGE = "docs/results/weight.md"
HEADING = """# Weight of the code

- **Command:** `python benchmarks/weight.py --page`; `--names` lists the modules and names.

A code line holds a token of a statement that is neither a docstring nor an import. A key is a value in `conf`, apart
from `_target_`, `_partial_`, lists of defaults and settings of Hydra. `tests/test_weight.py` limits the amounts of the
first table.
"""
# Keys of `conf` that are no settings of this project.
NO_SETTINGS = ("_target_", "_partial_", "defaults", "hydra")
SKIPPED = (tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING)


@dataclass(frozen=True)
class Module:
    """A source file."""

    path: Path
    """Path from the project's root."""
    text: str
    """Source text."""
    tree: ast.Module
    """Syntax tree of `text`."""

    @property
    def name(self) -> str:
        """Dotted import name."""
        return ".".join(self.path.with_suffix("").parts).removesuffix(".__init__")

    @property
    def package(self) -> str:
        """Dotted name of the folder."""
        return ".".join(self.path.parent.parts)


def modules(root: Path, folders: tuple[str, ...]) -> list[Module]:
    """All Python files below `folders` of `root`, by path."""
    paths = sorted(path for folder in folders for path in (root / folder).rglob("*.py"))
    texts = [path.read_text() for path in paths]
    return [Module(path.relative_to(root), text, ast.parse(text)) for path, text in zip(paths, texts, strict=True)]


def documented(tree: ast.Module) -> Iterator[tuple[ast.AST, ast.Constant]]:
    """Definitions (or fields) with the constants that document them: every string that is a statement."""
    for owner in ast.walk(tree):
        body = getattr(owner, "body", None)
        for statement in body if isinstance(body, list) else ():
            value = statement.value if isinstance(statement, ast.Expr) else None
            if isinstance(value, ast.Constant) and isinstance(value.value, str):
                yield owner, value


def code_lines(module: Module) -> int:
    """Number of lines with a token that is not of a docstring, an import or a comment."""
    left_out: set[int] = set()
    for _, constant in documented(module.tree):
        left_out.update(range(constant.lineno, (constant.end_lineno or constant.lineno) + 1))
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            left_out.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(module.text).readline):
        if token.type not in SKIPPED and token.type != tokenize.ENDMARKER:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines - left_out)


def imported(module: Module, known: set[str]) -> set[str]:
    """Names of the modules of `known` that a module imports, at its top or inside a function."""
    found: set[str] = set()
    for node in ast.walk(module.tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.update({node.module} | {f"{node.module}.{alias.name}" for alias in node.names})
    return found & known


def single_importers(sources: list[Module]) -> list[tuple[str, str]]:
    """Modules that exactly one module imports, one of their own package: (module, importer)."""
    known = {module.name for module in sources}
    importers = defaultdict(set)
    for module in sources:
        for name in imported(module, known) - {module.name}:
            importers[name].add(module)
    return [
        (module.name, next(iter(importers[module.name])).name)
        for module in sources
        if module.path.name != "__init__.py"
        and len(importers[module.name]) == 1
        and next(iter(importers[module.name])).package == module.package
    ]


def double_names(sources: list[Module]) -> tuple[dict[str, list[str]], dict[str, list[str]]]:
    """Module names in several packages, and public classes or functions defined in several modules, with those."""
    files: dict[str, list[str]] = defaultdict(list)
    definitions: dict[str, list[str]] = defaultdict(list)
    for module in sources:
        if module.path.name != "__init__.py":
            files[module.path.stem].append(module.package)
        for node in module.tree.body:
            name = node.name if isinstance(node, ast.ClassDef | ast.FunctionDef) else "_"
            if not name.startswith("_") and name != "main":
                definitions[name].append(module.name)
    several = [{name: of for name, of in table.items() if len(of) > 1} for table in (files, definitions)]
    return several[0], several[1]


def tics(sources: list[Module]) -> Counter[str]:
    """Number of docstrings and comments with each phrase of `TICS`."""
    counts = Counter(dict.fromkeys(TICS, 0))
    for module in sources:
        docstrings = [constant.value for _, constant in documented(module.tree)]
        comments = [
            token.string
            for token in tokenize.generate_tokens(io.StringIO(module.text).readline)
            if token.type == tokenize.COMMENT
        ]
        for phrase, pattern in TICS.items():
            if pattern is None:
                counts[phrase] += sum(bool(QUESTION.match(str(text))) for text in docstrings)
            else:
                counts[phrase] += sum(bool(pattern.search(str(text))) for text in (*docstrings, *comments))
    return counts


def settings(value: Any) -> int:
    """Number of keys with a value, in a mapping of mappings."""
    if not isinstance(value, dict):
        return 1
    return sum(settings(inner) for key, inner in value.items() if key not in NO_SETTINGS)


def amounts(root: Path) -> dict[str, int]:
    """What `tests/test_weight.py` limits, by name."""
    found: dict[str, int] = {}
    for folder in SOURCES:
        sources = modules(root, (folder,))
        found |= {f"files of {folder}": len(sources), f"code lines of {folder}": sum(map(code_lines, sources))}
    found["code lines of tests"] = sum(map(code_lines, modules(root, ("tests",))))
    files = list((root / "conf").rglob("*.yaml"))
    found["files of conf"] = len(files)
    found["keys of conf"] = sum(settings(yaml.safe_load(path.read_text()) or {}) for path in files)
    found["words of docs"] = sum(len(path.read_text().split()) for path in (root / "docs").rglob("*.md"))
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    found["commands"] = len(project["scripts"])
    return found


def row(*cells: object) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def print_tables(root: Path) -> None:
    """Print the tables of a checkout."""
    sources = modules(root, SOURCES)
    tests = modules(root, ("tests",))
    print(row("limited", "amount"), row("---", "--:"), sep="\n")
    for name, amount in amounts(root).items():
        print(row(name, amount))

    weights: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for module in sources:
        for group in (module.package, "**lmd + pipelines**"):
            for column, amount in enumerate((1, module.text.count("\n"), code_lines(module))):
                weights[group][column] += amount
    print("\n" + row("package", "files", "lines", "code lines"), row("---", "--:", "--:", "--:"), sep="\n")
    for group, weight in sorted(weights.items()):
        print(row(group, *weight))
    print(row("tests", len(tests), sum(m.text.count("\n") for m in tests), sum(map(code_lines, tests))))

    files, definitions = double_names(sources)
    docstrings = sum(1 for module in sources for _ in documented(module.tree))
    print("\n" + row("of lmd + pipelines", "number"), row("---", "--:"), sep="\n")
    print(row("modules with one importer, of their package", len(single_importers(sources))))
    print(row("module names in several packages", len(files)))
    print(row("public classes and functions defined in several modules", len(definitions)))
    print(row("docstrings", docstrings))
    for phrase, number in tics(sources).items():
        print(row(phrase, number))


def main() -> None:
    """Print the tables, or write them to the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=HERE, help="a checkout of the project")
    parser.add_argument("--names", action="store_true", help="list the modules and names too")
    parser.add_argument("--page", action="store_true", help=f"write the tables to {PAGE}")
    options = parser.parse_args()
    if options.page:
        with contextlib.redirect_stdout(io.StringIO()) as text:
            print_tables(options.folder)
        (options.folder / PAGE).write_text(f"{HEADING}\n{text.getvalue()}")
        return
    print_tables(options.folder)
    if options.names:
        sources = modules(options.folder, SOURCES)
        files, definitions = double_names(sources)
        for name, importer in single_importers(sources):
            print(f"one importer: {name} <- {importer}")
        for name, of in (*files.items(), *definitions.items()):
            print(f"several: {name}: {', '.join(of)}")


if __name__ == "__main__":
    main()
