"""Sensitivity of the metrics of a deployment to the assumptions on noise, tags, and detection.

A variant is the problem with another value of one assumption. All variants are measured off the grid, at equal random
positions and orientations (`lmd.evaluation.validation`), so their metrics differ only because of the assumption. For
any objective there are two metrics, the means of L and of P_n over the positions. L is the probability that a view
localises the camera to the tolerance, P_n the probability that a view covers n landmarks.

The landmarks in each image are found once; those that are missed or lost are then removed.

For a single camera, the metrics are computed from the bit sets of a compiled field (the incremental evaluator of the
objective). The mean of P_n with missed landmarks is then exact, from the binomial distribution. For a rig, a random
draw decides which landmarks are missed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import binom

from lmd.core.bits import packed
from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray
from lmd.core.threads import at_once
from lmd.evaluation.accuracy import as_localisation
from lmd.evaluation.maps import percent_text
from lmd.evaluation.validation import Sample, sampled_evaluators
from lmd.incremental.field import in_order
from lmd.incremental.state import counts_of
from lmd.incremental.trial import remove_sets
from lmd.objectives.coverage import Mean
from lmd.objectives.localisation import Localisation
from lmd.objectives.localisation.evaluation import localised_views
from lmd.objectives.localisation.field import LocalisationField
from lmd.objectives.localisation.rig import RigImages, covers, images_of, located
from lmd.objectives.without import without_landmarks
from lmd.problem import Problem
from lmd.scene.deployment import Deployment
from lmd.scene.rig import Mount, Rig
from lmd.scene.scene import Scene
from lmd.sight.evaluator import Evaluator, averaged
from lmd.sight.kernels import PROBABILITY_ONE


@dataclass(frozen=True)
class RigViews:
    """Views of a rig from poses of its body, and the conditions on which a view localises the rig."""

    evaluator: Evaluator
    deployment: Deployment
    """K landmarks."""
    n: int
    """Number of landmarks that must be covered."""
    precision: Any
    """Precision that the pose of a localised view must have, see `lmd.objectives.localisation.information`."""

    @cached_property
    def images(self) -> RigImages:
        """Images of the rig in all N views, with the landmarks that each camera shows."""
        return images_of(self.evaluator, self.deployment)

    @property
    def share(self) -> FloatArray:
        """Probability of each view, `(N,)`, sum 1."""
        weight = self.images.weight
        return np.asarray(weight / weight.sum())

    def decided(self, images: RigImages, seen: BoolArray) -> BoolArray:
        """Two masks of the M views in `images`, `(2, M)`: the views in which the rig is localised, and the views that
        cover n landmarks. The mask `seen` `(C, M, K)` has the landmarks that the C cameras show.
        """
        found = located(self.evaluator, self.deployment, images._replace(seen=seen), self.n, self.precision)
        return np.stack([found, covers(seen, self.n)])

    def without_cameras(self) -> FloatArray:
        """Fractions of localised views (column 0) and of views that cover n landmarks (column 1), `(C, 2)`.

        In each row, one of the C cameras fails.
        """
        seen, others = self.images.seen, ~np.eye(len(self.images.seen), dtype=bool)[..., None, None]
        return np.array([self.decided(self.images, seen & left) @ self.share for left in others])

    def missed(self, probabilities: Sequence[float], rng: np.random.Generator) -> FloatArray:
        """Fractions of localised views (column 0) and of views that cover n landmarks (column 1), `(M, 2)`.

        In each row, landmarks in an image are missed with one of M `probabilities`. All rows share the random draw, so
        that a landmark missed at one probability is missed at all greater probabilities.
        """
        seen = self.images.seen
        draw = rng.random(seen.shape, dtype=np.float32)
        return np.array([self.decided(self.images, seen & (draw >= p)) @ self.share for p in probabilities])

    def lost(self) -> FloatArray:
        """Fractions of localised views and of views that cover n landmarks, `(2, K, K)`, if landmarks i and j are lost.

        On the diagonal, only landmark i is lost. A lost landmark is not detected, but still hides other landmarks.
        """
        seen, share = self.images.seen, self.share
        shown = np.asarray(seen.any(axis=0))  # (N, K)
        whole, count = self.decided(self.images, seen).astype(np.float64), seen.shape[2]

        def lose(*landmarks: int) -> FloatArray:
            """Change of both fractions that each view causes if all of `landmarks` are lost, `(2, N)`.

            The fractions are those of localised views and of views that cover n landmarks. The change is 0 in views
            that do not show all of `landmarks`.
            """
            which: BoolArray = np.asarray(shown[:, landmarks].all(axis=1))
            left = seen[:, which]
            left[:, :, landmarks] = False
            change = np.zeros_like(whole)
            decided = self.decided(self.images.some(which), left).astype(np.float64)
            change[:, which] = share[which] * (decided - whole[:, which])
            return change

        alone = np.stack([lose(k) for k in range(count)], axis=1)  # (2, K, N)
        only = alone @ (~shown)  # change by k in the views that do not show the other landmark, (2, K, K)
        change = only + np.swapaxes(only, 1, 2)
        for i, j in combinations(range(count), 2):
            change[:, i, j] = change[:, j, i] = change[:, i, j] + lose(i, j).sum(axis=1)
        one = list(range(count))
        change[:, one, one] = alone.sum(axis=2)
        return np.asarray((whole @ share)[:, None, None] + change)


FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0)  # multiples of the assumed value
MISS_PROBABILITIES = (0.0, 0.05, 0.1, 0.2)  # probabilities that a covered landmark is not detected, ascending
SAMPLE = Sample(groups=48, positions=128, divisions=12)
SHARE_COLUMNS = ["localised_share", "covered_share"]
MISSES_STREAM = 0x6D697373  # separates the random numbers of missed landmarks from other uses of the seed


@dataclass(frozen=True)
class Variant:
    """Problem in which one assumption has another value."""

    assumption: str
    """Name of the setting that is varied."""
    factor: float
    """Ratio of the varied value to the value that the problem assumes."""
    value: float
    """Varied value, in the unit of the setting."""
    scene: Scene
    """Scene with the varied value."""
    objective: Localisation
    """Objective with the varied value."""
    deployment: Deployment
    """Deployment with the varied value."""
    note: str = ""
    """Reason why the metrics of the variant are missing; empty if they exist."""


@dataclass(frozen=True)
class Sensitivity:
    """Shares of views that localise the camera and of views that cover n landmarks, under changed assumptions."""

    assumptions: pd.DataFrame
    """Table with the columns `assumption,factor,value,localised_share,covered_share,note`; the shares are NaN in rows
    with a note.
    """
    misses: pd.DataFrame
    """Table with `missed,localised_share,covered_share`; a covered landmark is missed with probability `missed`."""
    tags: pd.DataFrame
    """Table with the columns `id,localised_loss,covered_loss`: decrease of the two shares (localised, covered) if this
    landmark is lost.
    """
    lost: pd.DataFrame
    """Table with the columns `lost,share,mean,worst,worst_ids`: mean and greatest decrease of each share if one
    landmark (`lost` = 1) or a pair of landmarks (`lost` = 2) is lost.
    """
    cameras: pd.DataFrame | None = None
    """Table with the columns `camera,localised_share,covered_share,localised_loss,covered_loss`, with a row for the
    failure of each camera of a rig; None for a single camera.
    """

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """See `lmd.evaluation.Study.tables`."""
        tables = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: table for name, table in tables.items() if table is not None}

    def metrics(self) -> dict[str, float]:
        """Finite metrics, keyed by names such as `pixel_noise_1.4/localised_share`."""
        named = {f"{row['assumption']}_{row['factor']:g}": row for row in self.assumptions.to_dict("records")}
        named |= {f"missed_{row['missed']:g}": row for row in self.misses.to_dict("records")}
        if self.cameras is not None:
            named |= {f"camera_{row['camera']}_fails": row for row in self.cameras.to_dict("records")}
        figures = {f"{name}/{share}": row[share] for name, row in named.items() for share in SHARE_COLUMNS}
        for row in self.lost.to_dict("records"):
            figures |= {f"lost_{row['lost']}/{row['share']}_{kind}": row[kind] for kind in ("mean", "worst")}
        return {name: float(value) for name, value in figures.items() if np.isfinite(value)}

    def to_text(self) -> str:
        """Text for a terminal, with shares in per cent."""
        by_factor = self.assumptions.groupby("factor")
        each = {f"x {x:g}": rows.set_index("assumption")[SHARE_COLUMNS].stack() for x, rows in by_factor}
        varied = pd.DataFrame(each)
        missed = self.misses.set_index("missed").T
        missed.columns = pd.Index([f"missed {share:g}" for share in missed.columns])
        rows = self.assumptions.to_dict("records")
        notes = [f"edge x {row['factor']:g}: {row['note']}" for row in rows if row["note"]]
        tables = [missed, self.lost.set_index(["lost", "share"])]
        if self.cameras is not None:
            tables.append(self.cameras.set_index("camera").rename_axis("camera fails"))
        return "\n\n".join(["sensitivity, per cent", percent_text(varied), *notes, *map(percent_text, tables)])


def sensitivity(problem: Problem, deployment: Deployment, seed: int, sample: Sample = SAMPLE) -> Sensitivity:
    """Measure the metrics of a deployment with other values of the assumptions. Results do not depend on the number of
    threads.

    Args:
        problem: problem with the scene; assumptions come from its objective, or from the default `Localisation`.
        deployment: K landmarks.
        seed: seed of the random poses, and of the missed landmarks.
        sample: number of random poses.
    """
    variants = _variants(problem, deployment)
    groups = enumerate(sampled_evaluators(problem.scene, problem.count, seed, sample, threads=1))
    measure = partial(_measure, deployment, as_localisation(problem.objective), variants, seed)
    parts = at_once(problem.evaluator.threads, measure, groups)
    assumed, missed, without, failed = (np.mean(part, axis=0) for part in zip(*parts, strict=True))
    rows = [[v.assumption, v.factor, v.value, *shares, v.note] for v, shares in zip(variants, assumed, strict=True)]
    losses = missed[0][:, None, None] - without
    tags, many = np.diagonal(losses, axis1=1, axis2=2), range(1, min(2, len(deployment)) + 1)
    ids, shares = deployment.ids, list(enumerate(SHARE_COLUMNS))
    return Sensitivity(
        assumptions=pd.DataFrame(rows, columns=["assumption", "factor", "value", *SHARE_COLUMNS, "note"]),
        misses=pd.DataFrame(missed, pd.Index(MISS_PROBABILITIES, name="missed"), SHARE_COLUMNS).reset_index(),
        tags=pd.DataFrame({"id": ids, "localised_loss": tags[0], "covered_loss": tags[1]}),
        lost=pd.DataFrame([_worst(lost, share, losses[i], ids) for i, share in shares for lost in many]),
        cameras=_cameras(failed, missed[0]) if len(failed) else None,
    )


def _cameras(failed: FloatArray, whole: FloatArray) -> pd.DataFrame:
    """Make the table `Sensitivity.cameras` of the failures of a rig's cameras.

    Both arguments have the fraction of localised views, and then that of views that cover n landmarks. `failed` `(C,
    2)` has a row for the failure of each of C cameras, and `whole` `(2,)` is for all cameras.
    """
    table = pd.DataFrame(failed, columns=SHARE_COLUMNS).rename_axis("camera").reset_index()
    return table.assign(localised_loss=whole[0] - failed[:, 0], covered_loss=whole[1] - failed[:, 1])


def _variants(problem: Problem, deployment: Deployment) -> list[Variant]:
    """Variants of the problem, one for each value of each varied setting. The edge length is varied only for tags, not
    for points.
    """
    scene, objective = problem.scene, as_localisation(problem.objective)
    variants = []
    for name in ("pixel_noise", "tolerance"):
        for factor in FACTORS:
            value = factor * getattr(objective, name)
            variants.append(Variant(name, factor, value, scene, replace(objective, **{name: value}), deployment))
    for factor in FACTORS if not scene.tag.is_point else ():
        tag = replace(scene.tag, edge=factor * scene.tag.size)
        seen = replace(scene.visibility, tag=tag) if hasattr(scene.visibility, "tag") else scene.visibility  # type: ignore[type-var]
        resized, note = replace(scene, tag=tag, visibility=seen), ""
        larger = replace(deployment, edges=factor * deployment.edges_of(scene.tag))
        try:
            resized.footprints.check(larger)
        except InputError as error:
            note = str(error)
        variants.append(Variant("edge", factor, tag.size, resized.sized(larger.edges), objective, larger, note))
    return variants


def _measure(
    deployment: Deployment,
    objective: Localisation,
    variants: Sequence[Variant],
    seed: int,
    group: tuple[int, Evaluator],
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Measure the fractions of localised views and of views that cover n landmarks, in one group of random poses.

    Returns:
        variants: the two fractions for each of V variants, `(V, 2)`.
        missed: the two fractions for each of M probabilities of missing a landmark, `(M, 2)`.
        lost: the two fractions if landmarks i and j are lost, `(2, K, K)`.
        failed: the two fractions if one of C cameras of a rig fails, `(C, 2)`; C = 0 for a single camera.
    """
    number, evaluator = group
    assumed = np.array([_shares(variant, evaluator) for variant in variants])
    rng = np.random.default_rng([seed, MISSES_STREAM, number])
    scene = evaluator.scene
    if scene.rig is not None or evaluator.by_reference:
        if scene.rig is None:  # a rig of one camera at the body's origin has the figures of that camera
            scene = replace(scene, camera=Rig((Mount(scene.cameras[0]),)))
        moved = Evaluator(scene, evaluator.positions, evaluator.threads, states=evaluator.states)
        rig = RigViews(moved, deployment, objective.n, objective.precision(scene))
        failed = rig.without_cameras() if evaluator.scene.rig is not None else np.empty((0, 2))
        return assumed, rig.missed(MISS_PROBABILITIES, rng), rig.lost(), failed
    field = objective.field(evaluator)
    assert isinstance(field, LocalisationField)  # the field of a single camera
    return assumed, missed_shares(field, deployment, rng)[:, :2], lost_shares(field, deployment), np.empty((0, 2))


def _shares(variant: Variant, evaluator: Evaluator) -> tuple[float, float]:
    """Fractions of localised views and of views that cover n landmarks, for one variant of the problem.

    The views are those of the evaluator. If the variant has a note, its tags do not fit, and the fractions are NaN.
    """
    if variant.note:
        return np.nan, np.nan
    scene, objective = replace(variant.scene, pdf=evaluator.scene.pdf), variant.objective
    varied = Evaluator(scene, evaluator.positions, evaluator.threads, states=evaluator.states)
    landmarks = variant.deployment.positions[None], variant.deployment.normals[None]
    views = localised_views(varied, *landmarks, objective.n, objective.precision(scene))
    return views.localised.mean() / PROBABILITY_ONE, views.covered.mean() / PROBABILITY_ONE


def lost_shares(field: LocalisationField, deployment: Deployment) -> FloatArray:
    """Fractions of localised views and of views that cover n landmarks, `(2, K, K)`, if landmarks i and j are lost.

    On the diagonal, only landmark i is lost.
    """
    mean = Mean(in_order(field, np.ones(len(field.index_of))))
    shares = field._replace(weight=0.0), field.coverage
    return np.stack([without_landmarks(share, mean, deployment) for share in shares])


def missed_shares(field: LocalisationField, deployment: Deployment, rng: np.random.Generator) -> FloatArray:
    """Fractions of localised views and of views that cover n landmarks, if covered landmarks are missed at random.

    Each landmark is missed with one of the M probabilities `MISS_PROBABILITIES`.

    The first fraction is estimated by one draw for every landmark in every view. All probabilities share the draw, so
    that a landmark missed at one probability is missed at all greater probabilities. The second fraction is exact, as
    the number of detected landmarks is binomial. Missed landmarks still hide other landmarks.

    Args:
        field: incremental evaluator with positions and orientations.
        deployment: K landmarks.
        rng: source of the draws.

    Returns:
        `(M, 3)`: the two fractions, and the second fraction as estimated by the draw.
    """
    cover, rows = field.coverage, []
    known, places = cover.state(deployment), field.index_of
    weights = (cover.weights[places] if len(cover.weights) > 1 else cover.weights) / PROBABILITY_ONE
    axes = weights.shape[1]
    counts = counts_of(known, axes)[places]
    draws = (rng.random((field.size, axes), dtype=np.float32) for _ in range(len(deployment)))
    sets = np.stack([[packed(draw < share) for share in MISS_PROBABILITIES] for draw in draws], axis=1)
    for share, missed in zip(MISS_PROBABILITIES, sets, strict=True):
        remove_sets(missed, cover, known)
        state = field.state_with(known)
        enough = binom.sf(cover.n - 1, np.arange(len(deployment) + 1), 1.0 - share)
        localised, sampled = (units[places].mean() / PROBABILITY_ONE for units in (state.located, known.units))
        rows.append((localised, averaged(enough[counts], weights).mean(), sampled))
    return np.array(rows)


def _worst(lost: int, share: str, losses: FloatArray, ids: IntArray) -> dict[str, object]:
    """Make a row of `Sensitivity.lost`: the mean and the greatest decrease of the share named `share` if landmarks are
    lost.

    `lost` is the number of lost landmarks, 1 or 2. `losses` `(K, K)` has the decrease for the loss of landmarks i and
    j, and `ids` the ids of the landmarks.
    """
    chosen = list(combinations(range(len(losses)), lost))
    values = np.array([losses[group[0], group[-1]] for group in chosen])
    worst = " ".join(map(str, ids[[*chosen[int(values.argmax())]]]))
    return {"lost": lost, "share": share, "mean": values.mean(), "worst": values.max(), "worst_ids": worst}
