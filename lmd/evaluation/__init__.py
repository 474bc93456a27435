"""Evaluation of deployments: bounds, validation, robustness, and comparison of optimisers."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd


class Study(Protocol):
    """Result of a study of a deployment. The study evaluates the deployment without some tags, with mounting errors,
    with measured poses of the tags, or under other assumptions.
    """

    @property
    def tables(self) -> "Mapping[str, pd.DataFrame | Mapping[str, ArrayLike]]":
        """Tables keyed by name, each with named columns; the index of a DataFrame is not one of its columns."""

    def metrics(self) -> dict[str, float]:
        """Metrics, keyed by name; all values are finite."""

    def to_text(self) -> str:
        """Results of the study as text for a terminal."""
