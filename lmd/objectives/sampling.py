"""Random positions and orientations on which the fitness is computed, because an optimiser would overfit the room's
grid.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from lmd.core.checks import Checked, Count, IntArray, returned
from lmd.core.memory import check_memory
from lmd.scene.pdf import divisions_of
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator
from lmd.space.crowd import CrowdStates

POSITION_BYTES = 3 * 8


@dataclass(frozen=True)
class Sampling(Checked):
    """Size of a stratified random sample of positions and orientations.

    Args:
        positions: number of positions drawn in the cell of each grid position; the relevance of the grid position is
            divided among them.
        divisions: one orientation is drawn in each of (2 `divisions`) x `divisions` cells, which have equal probability
            under the continuous distribution behind the PDF. A PDF of only the yaw has fewer cells, see
            `lmd.scene.pdf.OrientationPdf.stratified`. A PDF from samples is used unchanged.

    Raises:
        InputError: a number is less than 1, or there is not enough memory for the orientations.
    """

    positions: Count = 20
    divisions: int = 18

    def _validate(self) -> None:
        object.__setattr__(self, "divisions", divisions_of(self.divisions))

    def evaluator(self, scene: Scene, repeats: int, rng: np.random.Generator, threads: int | None) -> Evaluator:
        """Evaluator at random positions, `repeats` in each cell of the room's grid.

        The positions come in rounds. A round has one position in each cell, in the order of the cells. The method
        `repeats` may increase the number of rounds.

        Raises:
            InputError: there is not enough memory for the positions.
        """
        cells = len(scene.room.grid())
        repeats = self.repeats(scene, repeats)
        what = f"sampling.positions = {repeats} in each of {cells} cells"
        check_memory(POSITION_BYTES * repeats * cells, what, "sampling.positions")
        positions = scene.room.jittered_grid(repeats, rng)
        positions = returned(scene.room, "jittered_grid", positions, repeats * cells, 3)
        drawn = replace(scene, pdf=scene.pdf.stratified(self.divisions, rng))
        if scene.crowd is None:
            return Evaluator(drawn, positions, threads)
        return Evaluator(drawn, positions, threads, states=_states(scene.crowd, repeats, cells, rng))

    def repeats(self, scene: Scene, least: int) -> int:
        """Number of positions drawn in each cell of the grid; at least `least`.

        The number is `least`, unless the fitness is the mean over the worst crowd states (arrangements of people). In
        that case, if there are no more than `least` states, it is `least` rounded up to a multiple of the number of
        states.
        """
        crowd = scene.crowd
        if crowd is None or crowd.crowd.fitness == "mean" or least < len(crowd):
            return least
        return math.ceil(least / len(crowd)) * len(crowd)


def _states(crowd: CrowdStates, repeats: int, cells: int, rng: np.random.Generator) -> IntArray:
    """Index of the crowd state (arrangement of people) at each position of `jittered_grid`, `(repeats cells,)`.

    Each of the grid's cells has `repeats` positions. If the fitness is the mean over all states, successive positions
    of a cell have successive states. The state of a cell's first position is random; each state comes first in about
    equally many cells.

    If the fitness is the mean over the worst states, each state has equally many positions in every cell. If there are
    more states than positions in a cell, only a random choice of `repeats` states is used.
    """
    count = len(crowd)
    if crowd.crowd.fitness == "mean":
        first = rng.permutation(cells) % count
        return np.asarray((first + np.arange(repeats)[:, None]) % count).reshape(-1)
    chosen = np.sort(rng.permutation(count)[:repeats])
    return np.repeat(chosen, repeats // len(chosen) * cells)
