"""Evaluation of deployments: bounds, validation, robustness, and comparison of optimisers."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd


class Study(Protocol):
    """Result of a study of a deployment: without a tag, as mounted, as measured, under other assumptions."""

    @property
    def tables(self) -> "Mapping[str, pd.DataFrame | Mapping[str, ArrayLike]]":
        """Tables by name, each with its columns by name; an index is not a column."""

    def metrics(self) -> dict[str, float]:
        """Finite figures by name."""

    def to_text(self) -> str:
        """Text for a terminal."""
