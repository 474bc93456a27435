"""Weigh the code: `python benchmarks/weight.py [FOLDER]`.

Prints Markdown tables: files, lines and code lines of each package; modules that a single module of their package
imports; public names with more than one definition; counts of phrases that STYLE forbids.

A code line holds a token of a statement that is neither a docstring nor an import.
"""

import argparse
import ast
import io
import re
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

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


def row(*cells: object) -> str:
    """A row of a Markdown table."""
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=HERE, help="a checkout of the project")
    parser.add_argument("--names", action="store_true", help="list the modules and names too")
    options = parser.parse_args()
    sources = modules(options.folder, SOURCES)
    tests = modules(options.folder, ("tests",))

    weights: dict[str, list[int]] = defaultdict(lambda: [0, 0, 0])
    for module in sources:
        for group in (module.package, "**lmd + pipelines**"):
            for column, amount in enumerate((1, module.text.count("\n"), code_lines(module))):
                weights[group][column] += amount
    print(row("package", "files", "lines", "code lines"), row("---", "--:", "--:", "--:"), sep="\n")
    for group, amounts in sorted(weights.items()):
        print(row(group, *amounts))
    print(row("tests", len(tests), sum(m.text.count("\n") for m in tests), sum(map(code_lines, tests))))

    singles = single_importers(sources)
    files, definitions = double_names(sources)
    docstrings = sum(1 for module in sources for _ in documented(module.tree))
    print("\n" + row("of lmd + pipelines", "number"), row("---", "--:"), sep="\n")
    print(row("modules with one importer, of their package", len(singles)))
    print(row("module names in several packages", len(files)))
    print(row("public classes and functions defined in several modules", len(definitions)))
    print(row("docstrings", docstrings))
    for phrase, number in tics(sources).items():
        print(row(phrase, number))
    if options.names:
        for name, importer in singles:
            print(f"one importer: {name} <- {importer}")
        for name, of in (*files.items(), *definitions.items()):
            print(f"several: {name}: {', '.join(of)}")


if __name__ == "__main__":
    main()
