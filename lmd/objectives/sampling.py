"""Fresh positions and orientations instead of the room's grid, which an optimiser learns by heart."""

from dataclasses import dataclass, replace

import numpy as np

from lmd.checks import integer
from lmd.scene import Scene
from lmd.sight.evaluator import Evaluator


@dataclass(frozen=True)
class Sampling:
    """Random positions and orientations for a fitness that the room's grid cannot fool.

    Args:
        positions: drawn in the cell of each position of the room's grid, whose relevance they share.
        divisions: orientations are drawn one in each of 2 `divisions` x `divisions` cells of equal probability, from
            the continuous distribution that the PDF stands for; a PDF from samples is taken as it is.

    Raises:
        InputError: a number is less than 1.
    """

    positions: int = 20
    divisions: int = 18

    def __post_init__(self) -> None:
        for name in ("positions", "divisions"):
            object.__setattr__(self, name, integer(name, getattr(self, name), low=1))

    def evaluator(self, scene: Scene, repeats: int, rng: np.random.Generator, threads: int | None) -> Evaluator:
        """The evaluator at a draw of `repeats` positions in each cell, which go through the grid again and again."""
        positions = scene.room.jittered_grid(repeats, rng)
        return Evaluator(replace(scene, pdf=scene.pdf.stratified(self.divisions, rng)), positions, threads)
