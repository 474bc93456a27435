"""Fresh positions and orientations instead of the room's grid, which an optimiser learns by heart."""

from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import check_fields, integer
from lmd.core.memory import check_memory
from lmd.scene.pdf import divisions_of
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator

POSITION_BYTES = 3 * 8


@dataclass(frozen=True)
class Sampling:
    """Random positions and orientations for a fitness that the room's grid cannot fool.

    Args:
        positions: drawn in the cell of each position of the room's grid, whose relevance they share.
        divisions: orientations are drawn one in each of 2 `divisions` x `divisions` cells of equal probability, from
            the continuous distribution that the PDF stands for, fewer of the yaw alone
            (`lmd.scene.pdf.OrientationPdf.stratified`); a PDF from samples is taken as it is.

    Raises:
        InputError: a number is less than 1, or there is not enough memory for the orientations.
    """

    positions: int = 20
    divisions: int = 18

    def __post_init__(self) -> None:
        check_fields(self, integer, "positions", low=1)
        object.__setattr__(self, "divisions", divisions_of(self.divisions))

    def evaluator(self, scene: Scene, repeats: int, rng: np.random.Generator, threads: int | None) -> Evaluator:
        """The evaluator at a draw of `repeats` positions in each cell, which go through the grid again and again.

        Raises:
            InputError: there is not enough memory for them.
        """
        cells = len(scene.room.grid())
        what = f"sampling.positions = {repeats} in each of {cells} cells"
        check_memory(POSITION_BYTES * repeats * cells, what, "sampling.positions")
        positions = scene.room.jittered_grid(repeats, rng)
        return Evaluator(replace(scene, pdf=scene.pdf.stratified(self.divisions, rng)), positions, threads)
