"""Problems with several objectives, all to be maximised."""

from collections.abc import Mapping, Sequence

import numpy as np
from typing_extensions import override

from lmd.core.checks import FloatArray, InputError
from lmd.optimisers.encoding import make_encoding
from lmd.problem import Problem, checked_genes
from lmd.scene.deployment import Deployment
from lmd.suite.black_box import IMPOSSIBLE, BlackBox

HUNG = 0.5
"""Least value of a tag's own gene at which the tag is hung."""


class SeveralObjectives(BlackBox):
    """Problem that places the landmarks of one scene for several objectives.

    Args:
        problems: two or more problems that differ only in their objective.
        name: see `BlackBox`.
        encoding: see `BlackBox`.

    Raises:
        InputError: there are fewer than two problems, or the encoding is unknown.
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

    def values_of(self, deployment: Deployment) -> FloatArray:
        """Value of each of the M objectives for a deployment, `(M,)`."""
        return np.array([box.problem.fitness_of(deployment) for box in self.boxes])

    @override
    def score(self, genes: FloatArray, seed: int = 0) -> Mapping[str, float]:
        scores = dict[str, float]()
        for box in self.boxes:
            scores |= {f"{box.objectives[0]}: {key}": value for key, value in box.score(genes, seed).items()}
        return scores


class TagChoice(BlackBox):
    """Problem in which tags may be left out, with two objectives: the fitness, and the fraction of the tags left out.

    The fraction is that of the number of tags, or of the area of paper. Each tag has an additional gene in [0, 1]: the
    tag is hung if this gene is at least `HUNG`. A candidate without hung tags has the fitness 0.

    Args:
        problem: problem in which all tags are hung.
        name: see `BlackBox`.
        encoding: see `BlackBox`.
        by_paper: True to weight each tag by the area of its square of paper, False to count tags.

    Raises:
        InputError: some landmarks are fixed, or the problem does not place landmarks.
    """

    def __init__(self, problem: Problem, name: str = "problem", encoding: str = "wall", by_paper: bool = False) -> None:
        super().__init__(problem, name, encoding)
        if problem.genome is not None or problem.fixed_count:
            raise InputError(f"{name}: the problem must place all tags itself, without fixed tags.", "problem")
        self._encoding = make_encoding(encoding, problem.scene.footprints.hanging, flush=True)
        self.by_paper = by_paper
        self.objectives = (*self.objectives, f"share of the {'paper' if by_paper else 'tags'} left over")

    @property
    @override
    def dim(self) -> int:
        return self.genome.dim + self.problem.count

    @override
    def start(self, seed: int = 0) -> FloatArray:
        genes, rng = super().start(seed), np.random.default_rng([int(seed), 1])
        return np.concatenate([genes, rng.random(self.problem.count)])

    @override
    def deployment(self, genes: FloatArray) -> Deployment:
        deployment = self._hung(checked_genes(genes, self.dim))
        if deployment is None:
            raise InputError(f"{self.name}: the candidate hangs no tag, or its tags do not fit.", "genes")
        return deployment

    def values_of(self, deployment: Deployment) -> FloatArray:
        """Values of the two objectives, `(2,)`, for a deployment that consists of the hung tags.

        The values are the deployment's fitness, and the fraction of all tags (or of their paper area) that is left out.
        """
        used, every = (
            (sizes**2).sum() if self.by_paper else len(sizes)
            for sizes in (deployment.edges_of(self.problem.scene.tag), self.problem.sizes)
        )
        enough = len(deployment) >= self.problem.objective.n
        return np.array([self.problem.fitness_of(deployment) if enough else 0.0, 1.0 - used / every])

    @override
    def _values(self, genes: FloatArray) -> FloatArray:
        return np.array([self._value(row) for row in genes]).reshape(len(genes), 2)

    def _value(self, row: FloatArray) -> FloatArray:
        if not (row[self.genome.dim :] >= HUNG).any():
            return np.array([0.0, 1.0])
        deployment = self._hung(row)
        return np.array([IMPOSSIBLE, 0.0]) if deployment is None else self.values_of(deployment)

    def _hung(self, row: FloatArray) -> Deployment | None:
        """Deployment of the hung tags of a candidate with the genes `row` `(d,)`; overlapping tags are pushed apart.

        None if no tag is hung, or if there is no room for the tags.
        """
        hangs = row[self.genome.dim :] >= HUNG
        if not hangs.any():
            return None
        positions, normals, surfaces = (each[0] for each in self._encoding.decode(row[None, : self.genome.dim]))
        every = self.problem.labelled(Deployment(positions, normals, surfaces))
        return self.problem.scene.footprints.separated(every[hangs])
