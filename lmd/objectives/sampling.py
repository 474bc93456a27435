"""Random positions and orientations for the fitness, as an optimiser would overfit the room's grid."""

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
    """Size of a stratified random sample of positions and orientations.

    Args:
        positions: number of positions drawn in the cell of each grid position; they share the relevance of that
            position.
        divisions: one orientation is drawn in each of 2 `divisions` x `divisions` cells of equal probability of the
            continuous distribution behind the PDF (fewer cells for a PDF of the yaw alone, see
            `lmd.scene.pdf.OrientationPdf.stratified`); a PDF from samples is used unchanged.

    Raises:
        InputError: a number is less than 1, or there is not enough memory for the orientations.
    """

    positions: int = 20
    divisions: int = 18

    def __post_init__(self) -> None:
        check_fields(self, integer, "positions", low=1)
        object.__setattr__(self, "divisions", divisions_of(self.divisions))

    def evaluator(self, scene: Scene, repeats: int, rng: np.random.Generator, threads: int | None) -> Evaluator:
        """Evaluator at random positions, `repeats` in each cell of the grid. Cells are in grid order, and this order is
        repeated `repeats` times.

        Raises:
            InputError: there is not enough memory for the positions.
        """
        cells = len(scene.room.grid())
        what = f"sampling.positions = {repeats} in each of {cells} cells"
        check_memory(POSITION_BYTES * repeats * cells, what, "sampling.positions")
        positions = scene.room.jittered_grid(repeats, rng)
        return Evaluator(replace(scene, pdf=scene.pdf.stratified(self.divisions, rng)), positions, threads)
