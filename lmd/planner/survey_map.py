"""Survey map: the result of a survey, which the planner draws beside the plan."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmd.core.checks import FloatArray, InputError
from lmd.core.files import read_text
from lmd.formats.tag_maps import read_deployment
from lmd.scene.deployment import Deployment

MAP, DOCUMENT = "map.csv", "survey.json"


@dataclass(frozen=True)
class SurveyMap:
    """Map of a survey, and the photographs that it proposes."""

    tags: Deployment
    """Tags as they hang."""
    photographs: FloatArray
    """`(N, 2, 3)` place and direction of each photograph, world frame, metres."""

    @classmethod
    def read(cls, folder: Any) -> "SurveyMap":
        """Read the directory of a survey.

        Raises:
            InputError: a file of the survey is missing or cannot be read.
        """
        tags = read_deployment(Path(str(folder)) / MAP, "survey")
        text = read_text(Path(str(folder)) / DOCUMENT, "survey")
        try:
            asked = json.loads(text)["next_photographs"]
            rows = np.array([[row["position"], row["direction"]] for row in asked], dtype=np.float64)
            return cls(tags, rows.reshape(-1, 2, 3))
        except (ValueError, KeyError, TypeError):
            raise InputError(f"survey: {str(folder)!r} holds no {DOCUMENT} of a survey.", "survey") from None

    def offsets(self, plan: Deployment, magnified: float) -> FloatArray:
        """Lines from planned places towards measured places, `magnified` times as long as the offset, `(n, 2, 3)`."""
        _, of, among = np.intersect1d(plan.ids, self.tags.ids, return_indices=True)
        start = plan.places[of]
        return np.stack([start, start + magnified * (self.tags.places[among] - start)], axis=1)
