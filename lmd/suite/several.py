"""Problems with two objectives, all of which are maximised."""

from collections.abc import Mapping, Sequence

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError
from lmd.optimisers.encoding import make_encoding
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.suite.black_box import IMPOSSIBLE, BlackBox

HUNG = 0.5
"""Gene of a tag from which on the tag is hung."""


class SeveralObjectives(BlackBox):
    """Several objectives of the landmarks of one scene.

    Args:
        problems: problems that differ in their objective alone; at least two.
        name: see `BlackBox`.
        encoding: see `BlackBox`.
    """

    def __init__(self, problems: Sequence[Problem], name: str = "problem", encoding: str = "wall") -> None:
        super().__init__(problems[0], name, encoding)
        self.boxes = [BlackBox(each, name, encoding) for each in problems]
        self.objectives = tuple(label for box in self.boxes for label in box.objectives)
        if len(self.boxes) < 2:
            raise InputError(f"{name}: at least two objectives are needed, got {len(self.boxes)}.", "problems")

    @override
    def _values(self, genes: FloatArray) -> FloatArray:
        return np.stack([box(genes) for box in self.boxes], axis=1)

    @override
    def score(self, genes: FloatArray, seed: int = 0) -> Mapping[str, float]:
        scores = dict[str, float]()
        for box in self.boxes:
            scores |= {f"{box.objectives[0]}: {key}": value for key, value in box.score(genes, seed).items()}
        return scores


class TagChoice(BlackBox):
    """The fitness against the share of the tags, or of their paper, that is left over.

    Each landmark has a gene more than in the problem: the tag is hung if the gene is at least `HUNG`. A candidate
    without tags has the fitness 0.

    Args:
        problem: problem with all tags hung.
        name: see `BlackBox`.
        encoding: see `BlackBox`.
        by_paper: True to weigh each tag by the area of its square, False to count tags.

    Raises:
        InputError: some landmarks are fixed, or the problem does not place landmarks.
    """

    def __init__(self, problem: Problem, name: str = "problem", encoding: str = "wall", by_paper: bool = False) -> None:
        super().__init__(problem, name, encoding)
        if problem.genome is not None or problem.fixed_count:
            raise InputError(f"{name}: a choice of tags needs a problem that places all landmarks.", "problem")
        self._encoding = make_encoding(encoding, problem.scene.footprints.hanging, flush=True)
        weights = problem.sizes**2 if by_paper else np.ones(problem.count)
        self.weights = weights / weights.sum()
        self.objectives = (*self.objectives, f"share of the {'paper' if by_paper else 'tags'} left over")

    @property
    @override
    def dim(self) -> int:
        return self.genome.dim + self.problem.count

    @override
    def start(self, seed: int = 0) -> FloatArray:
        rng = np.random.default_rng([seed, 1])
        return np.concatenate([super().start(seed), rng.random(self.problem.count)])

    @override
    def deployment(self, genes: FloatArray) -> Deployment:
        row = self._one(genes)
        deployment = self._hung(row)
        if deployment is None:
            raise InputError(f"{self.name}: the papers of this candidate find no room.", "genes")
        return deployment

    @override
    def _values(self, genes: FloatArray) -> FloatArray:
        return np.array([self._value(row) for row in genes])

    def _value(self, row: FloatArray) -> tuple[float, float]:
        """Fitness of a candidate `(d,)`, and the share that is left over."""
        left = float(self.weights[row[self.genome.dim :] < HUNG].sum())
        deployment = self._hung(row)
        if deployment is None:
            return IMPOSSIBLE, left
        enough = len(deployment) >= self.problem.objective.n
        return self.problem.fitness_of(deployment) if enough else 0.0, left

    def _hung(self, row: FloatArray) -> Deployment | None:
        """Tags that a candidate `(d,)` hangs, with their papers pushed apart; None if these find no room."""
        positions, normals, surfaces = (each[0] for each in self._encoding.decode(row[None, : self.genome.dim]))
        every = self.problem.labelled(Deployment(positions, normals, surfaces))
        chosen = every[row[self.genome.dim :] >= HUNG]
        return self.problem.scene.footprints.separated(chosen) if len(chosen) else chosen
