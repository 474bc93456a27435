"""Dependence of the standard deviations of a pose on the distance and the number of tags: a table, and fitted formulas
("laws").
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from lmd.core.checks import FloatArray, IntArray
from lmd.estimation.deviation_law import (
    LEAST_VIEWS,
    QUANTITIES,
    RULES,
    Law,
    Rule,
    fit_law,
    fit_power,
    fit_rule,
    ratio_quantiles,
)
from lmd.evaluation.uncertainty import NONE, ONE, TWO, Uncertainty

if TYPE_CHECKING:
    import pandas as pd

STEPS = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0)  # steps of the distance in the table, metres
MOST_STEPS = 12  # greatest number of steps of the distance
MANY = 5  # numbers of tags from here on share a row
AMBIGUOUS = 0.5  # share of ambiguous views above which a single tag is out of reach


@dataclass(frozen=True)
class UncertaintyLaw:
    """Formulas ("laws") for the standard deviations of a pose, given the distance and number of tags in view.

    The laws are fitted to those random views in which the pose is unambiguous.
    """

    laws: Mapping[str, Law]
    """Fitted formula for each standard deviation in `QUANTITIES`."""
    rules: Mapping[str, Mapping[str, Rule]]
    """Simpler formulas ("rules") that are commonly used instead of the law, keyed by name; each is fitted to each
    standard deviation in `QUANTITIES`.
    """
    errors: "pd.DataFrame"
    """Table of the errors of laws and rules, with the columns `quantity`, `rule` (`law`, `one law`, or one of `RULES`),
    and the quantiles of `ratio_quantiles`.
    """
    table: "pd.DataFrame"
    """Table with a row for each bin of distance and number of tags: `distance_low`, `distance_high` (m), `tags` (text),
    `views` (their number), and `two_poses` (share of ambiguous views). For the unambiguous views, it has the median and
    90 % quantile of each of `QUANTITIES` (m, rad).
    """
    reach: float
    """Distance below which at most half of the views of a single tag are ambiguous, metres; infinite without a
    limit.
    """

    def document(self) -> dict[str, Any]:
        """Laws, rules (simpler formulas in common use), and the errors of both, as a document for JSON."""
        errors = {
            quantity: {row["rule"]: {k: v for k, v in row.items() if k not in ("quantity", "rule")} for row in rows}
            for quantity, rows in ((q, self.errors[self.errors.quantity == q].to_dict("records")) for q in QUANTITIES)
        }
        return {
            "law": "sd = scale * distance^distance_exponent / tags^tags_exponent; metres and rad",
            "single_tag_reach": self.reach if np.isfinite(self.reach) else None,
            "laws": {
                quantity: {
                    group: {"scale": law.scale, "distance_exponent": law.distance, "tags_exponent": law.tags}
                    for group, law in (("one_tag", both.one), ("several_tags", both.several))
                }
                for quantity, both in self.laws.items()
            },
            "rules": {name: {q: asdict(rule) for q, rule in each.items()} for name, each in self.rules.items()},
            "deviation_over_rule": errors,
        }

    def lines(self, found: Uncertainty) -> dict[str, str]:
        """Lines for a terminal about the views, the corner errors and the laws, keyed by label."""
        figures, errors = found.metrics(), self.errors.set_index(["quantity", "rule"])

        def said(name: str, factor: float, unit: str) -> str:
            one, several = self.laws[name].one, self.laws[name].several
            return (
                f"one tag {factor * one.scale:.3g} {unit} d^{one.distance:.2f}; several {factor * several.scale:.3g} "
                f"{unit} d^{several.distance:.2f} / n^{several.tags:.2f}; 90 % within a factor "
                f"{errors.factor_90[name, 'law']:.2f}, d^2 / n {errors.factor_90[name, 'squared']:.2f}, constant "
                f"{errors.factor_90[name, 'constant']:.2f}"
            )

        return {
            "views": f"{len(found.views)}: {figures['share_one']:.1%} with one pose, {figures['share_two']:.1%} with "
            f"two (a single tag), {figures['share_none']:.1%} with none",
            "corners": f"errors {found.corners}",
            "position": said("position", 1e3, "mm"),
            "rotation": said("rotation", 1e3, "mrad"),
            "single tags": "have one pose" if self.reach == float("inf") else f"have one pose up to {self.reach:g} m",
        }


def per_axis(views: "pd.DataFrame") -> dict[str, FloatArray]:
    """Standard deviations of position, rotation and parts of both in V views, keyed by `QUANTITIES`, `(V,)` each.

    Standard deviations are root mean squares over the axes. `views` is the table `Uncertainty.views`.
    """

    def rms(*names: str) -> FloatArray:
        return np.asarray(np.sqrt(np.mean([views[f"sd_{name}"].to_numpy() ** 2 for name in names], axis=0)))

    position, rotation = ("x", "y", "z"), ("roll", "pitch", "yaw")
    parts = (position, position[:2], position[2:], rotation, rotation[:2], rotation[2:])
    return {name: rms(*part) for name, part in zip(QUANTITIES, parts, strict=True)}


def uncertainty_law(found: Uncertainty) -> UncertaintyLaw:
    """Fit laws, and rules (simpler formulas in common use), to the views with an unambiguous pose (kind `one`).

    Raises:
        InputError: too few views have an unambiguous pose.
    """
    import pandas as pd

    some = found.views[found.views.pose == ONE]
    where = some.distance.to_numpy(), some.tags.to_numpy()
    deviations = per_axis(some)
    laws = {name: fit_law(*where, each) for name, each in deviations.items()}
    rules = {shape: {name: fit_rule(shape, *where, each) for name, each in deviations.items()} for shape in RULES}
    errors = []
    for name, each in deviations.items():
        predicted = {"law": laws[name].at(*where), "one law": fit_power(*where, each).at(*where)}
        predicted |= {shape: rules[shape][name].at(*where) for shape in RULES}
        errors += [{"quantity": name, "rule": rule, **ratio_quantiles(each, p)} for rule, p in predicted.items()]
    return UncertaintyLaw(laws, rules, pd.DataFrame(errors), _table(found), _reach(found))


def _steps(distance: FloatArray) -> FloatArray:
    """Edges, metres, of equally wide bins that cover all of the given distances."""
    farthest = float(distance.max())
    step = next((each for each in STEPS if farthest / each <= MOST_STEPS), farthest / MOST_STEPS)
    return np.arange(np.ceil(farthest / step) + 1.0) * step


def _table(found: Uncertainty) -> "pd.DataFrame":
    """Make the table `UncertaintyLaw.table`: standard deviations of poses in bins of distance and number of tags."""
    import pandas as pd

    seen = found.views[found.views.pose != NONE]
    bounds = _steps(seen.distance.to_numpy())
    classes: IntArray = np.searchsorted(bounds, seen.distance.to_numpy(), side="left") - 1
    numbers = np.minimum(seen.tags.to_numpy(), MANY)
    deviations = pd.DataFrame(per_axis(seen), index=seen.index)
    rows = []
    for step, number in sorted(set(zip(classes.tolist(), numbers.tolist(), strict=True))):
        here = (classes == step) & (numbers == number)
        two = (seen.pose[here] == TWO).to_numpy()
        rows.append({
            "distance_low": bounds[step], "distance_high": bounds[step + 1],
            "tags": str(number) if number < MANY else f"{MANY}+", "views": int(here.sum()),
            "two_poses": float(two.mean()),
            **{
                f"sd_{name}_{label}": float(deviations[name][here][~two].quantile(level))
                for name in QUANTITIES for label, level in (("median", 0.5), ("90", 0.9))
            },
        })  # fmt: skip
    return pd.DataFrame(rows)


def _reach(found: Uncertainty) -> float:
    """Compute `UncertaintyLaw.reach`: the lower edge of the first bin of distance in which most views of a single tag
    are ambiguous. Bins with fewer than `LEAST_VIEWS` views of a single tag do not count.
    """
    alone = found.views[found.views.tags == 1]
    if not len(alone):
        return np.inf
    bounds, distance = _steps(alone.distance.to_numpy()), alone.distance.to_numpy()
    for low, high in pairwise(bounds.tolist()):
        here = (distance > low) & (distance <= high)
        if here.sum() >= LEAST_VIEWS and (alone.pose[here] == TWO).mean() > AMBIGUOUS:
            return float(low)
    return np.inf
