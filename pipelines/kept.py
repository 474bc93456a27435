"""Results on disk that no command computes again, each named by a digest of all that decides it."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from .outputs import read_document, write_document
from .provenance import digest

Content = TypeVar("Content")


def kept(
    folder: str, parts: tuple[Any, ...], compute: Callable[[], dict[str, Any]],
    content_of: Callable[[dict[str, Any]], Content],
) -> Content:  # fmt: skip
    """Result from the disk, or computed now and stored.

    Args:
        folder: folder of the results.
        parts: settings and deployments that decide the result, as `digest` takes them; the code of `lmd` does, too.
        compute: function that computes the result as a document.
        content_of: function that converts a document, see `read_document`.
    """
    from lmd.core.sources import package_digest

    path = Path(folder) / f"{digest(*parts, package_digest())}.json"
    found = read_document(path, content_of)
    if found is not None:
        return found
    computed = compute()
    path.parent.mkdir(parents=True, exist_ok=True)
    write_document(path, computed)
    return content_of(computed)
