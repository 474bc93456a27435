"""What every study beside the figures of a deployment has in common."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Protocol

from numpy.typing import ArrayLike

if TYPE_CHECKING:
    import pandas as pd


class Study(Protocol):
    """What came out of looking at a deployment in some way: without a tag, as mounted, on other assumptions."""

    @property
    def tables(self) -> "Mapping[str, pd.DataFrame | Mapping[str, ArrayLike]]":
        """Columns by their names, by the names of the tables; an index is none of them."""

    def metrics(self) -> dict[str, float]:
        """The finite figures, by name."""

    def to_text(self) -> str:
        """What a terminal shows."""
