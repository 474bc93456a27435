"""Hook of mkdocs: a page of the API for each package of `lmd`, made from its docstrings."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

PACKAGES = sorted(path.parent.name for path in (Path(__file__).parents[1] / "lmd").glob("*/__init__.py"))
MODULES = ["problem", "run"]  # public modules beside the packages


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the pages to the navigation."""
    (section,) = (each["Python"] for each in config.nav if "Python" in each)
    section += [{f"lmd.{name}": f"api/{name}.md"} for name in sorted(PACKAGES + MODULES)]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    for name in PACKAGES + MODULES:
        files.append(File.generated(config, f"api/{name}.md", content=f"# lmd.{name}\n\n::: lmd.{name}\n"))
    return files
