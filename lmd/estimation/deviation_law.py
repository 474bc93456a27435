"""Uncertainty laws: formulas for the standard deviation (sd) of the position or rotation of an estimated camera pose.

A filter may use a law for the noise of poses from images. A law consists of two power laws, one for views of a single
tag and one for views of several tags. With the mean distance d [m] of the n tags in view, each power law is

    sd = a d^b / n^c.

With one tag the position follows from the apparent size and tilt of a small square, with several tags from the angles
between the tags. b and c are fitted by least squares to log sd of many views. The scale a is the root mean square of sd
/ (d^b / n^c). So the ratios of a view's sd to the law have the mean square 1.

`RULES` are simpler formulas in common use, whose scale a is fitted likewise:

- `constant`: sd = a.
- `squared`: sd = a d^2 / n, as in AdvantageKit's vision template (`linearStdDevBaseline`).
- `photonvision`: sd = a (1 + d^2 / 30), with one value of a for a single tag and one for several, as in PhotonVision's
  example (`kSingleTagStdDevs`, `kMultiTagStdDevs`).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from lmd.core.checks import BoolArray, FloatArray, InputError, IntArray

# Standard deviations with a law: rms per axis of the position, of x and y, and of z, metres; rms per axis of the
# rotation, of roll and pitch, and of yaw, rad.
QUANTITIES = ("position", "horizontal", "vertical", "rotation", "tilt", "heading")
LEAST_VIEWS = 30  # minimum number of views for fitting a law
LEAST_VARIATION = 0.05  # an exponent is fitted if the standard deviation of log d, or of log n, is at least this
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)  # reported quantiles of the ratio of sd to its law


@dataclass(frozen=True)
class PowerLaw:
    """Standard deviation of a pose's position or rotation as a power law of the distance and number of tags in view.

    For n tags at the mean distance d, metres, the standard deviation is `scale` d^`distance` / n^`tags`.
    """

    scale: float
    """Scale a: sd of one tag at one metre, metres or rad."""
    distance: float = 0.0
    """Exponent b of the distance."""
    tags: float = 0.0
    """Exponent c of the number of tags."""

    def at(self, distance: FloatArray | float, tags: IntArray | int) -> FloatArray:
        """Standard deviations of the position (metres) or rotation (rad) of poses, according to the power law.

        The mean distances of the tags in view, `distance`, metres, and their numbers, `tags`, are broadcast against
        each other.
        """
        return np.asarray(
            self.scale * np.power(distance, self.distance) / np.power(np.asarray(tags, dtype=np.float64), self.tags)
        )


@dataclass(frozen=True)
class Law:
    """Uncertainty law: standard deviation of a pose's position or rotation, given the distance and number of tags.

    Views of a single tag have one power law (see `PowerLaw`), views of several tags another.
    """

    one: PowerLaw
    """Law for a single tag."""
    several: PowerLaw
    """Law for two or more tags."""

    def at(self, distance: FloatArray, tags: IntArray) -> FloatArray:
        """Standard deviations of the position (metres) or rotation (rad) in V views, `(V,)`.

        Args:
            distance: mean distance of the tags in each view, metres, `(V,)`.
            tags: number of tags in each view, `(V,)`.
        """
        return np.where(tags == 1, self.one.at(distance, 1), self.several.at(distance, tags))


@dataclass(frozen=True)
class Rule:
    """Formula in common use for the standard deviation of a pose's position or rotation.

    The formula is a scale times a fixed function of the mean distance and the number of tags in view, see `RULES`.
    """

    shape: str
    """Name of the rule, a key of `RULES`."""
    one: float
    """Scale a for a single tag, metres or rad."""
    several: float
    """Scale a for several tags, metres or rad."""

    def at(self, distance: FloatArray, tags: IntArray) -> FloatArray:
        """See `Law.at`."""
        return np.where(tags == 1, self.one, self.several) * RULES[self.shape](distance, tags)


# Each rule without its scale, as a function of d and n.
RULES: Mapping[str, Callable[[FloatArray, IntArray], FloatArray]] = {
    "constant": lambda distance, tags: np.ones(np.broadcast_shapes(distance.shape, tags.shape)),
    "squared": lambda distance, tags: distance**2 / tags,
    "photonvision": lambda distance, tags: 1.0 + distance**2 / 30.0 + 0.0 * tags,
}
BY_NUMBER = {"photonvision"}  # rules with one value of a for a single tag and one for several


def fit_power(distance: FloatArray, tags: IntArray, deviation: FloatArray) -> PowerLaw:
    """Fit a power law to the standard deviations of the position or rotation in V views.

    If the distance or the number of tags is nearly constant over the views, its exponent is 0.

    Args:
        distance: mean distance of the tags in each view, metres, `(V,)`.
        tags: number of tags in each view, `(V,)`.
        deviation: standard deviations, metres or rad, `(V,)`.
    """
    logs = {"distance": np.log(distance), "tags": -np.log(tags)}
    varied = {name: value for name, value in logs.items() if value.std() >= LEAST_VARIATION}
    columns = np.column_stack([np.ones(len(distance)), *varied.values()])
    found = np.linalg.lstsq(columns, np.log(deviation), rcond=None)[0]
    shape = PowerLaw(1.0, **dict(zip(varied, found[1:].tolist(), strict=True)))
    return PowerLaw(_scale(deviation, shape.at(distance, tags)), shape.distance, shape.tags)


def _scale(deviation: FloatArray, shape: FloatArray) -> float:
    """Scale of a law: the root mean square over V views of `deviation` / `shape`.

    `deviation` has the standard deviations, and `shape` what the law with the scale 1 predicts, `(V,)` each.
    """
    return float(np.sqrt(((deviation / shape) ** 2).mean()))


def fit_law(distance: FloatArray, tags: IntArray, deviation: FloatArray) -> Law:
    """Fit an uncertainty law to the standard deviations of the position or rotation in V views.

    One power law is fitted to the views of one tag, another to the views of several tags. If fewer than `LEAST_VIEWS`
    views show one tag (or several), all views are used for this power law.

    Args:
        distance: mean distance of the tags in each view, metres, `(V,)`.
        tags: number of tags in each view, `(V,)`.
        deviation: standard deviations, metres or rad, `(V,)`.

    Raises:
        InputError: there are fewer than `LEAST_VIEWS` views.
    """
    if len(deviation) < LEAST_VIEWS:
        raise InputError(
            f"views: only {len(deviation)} of the random views determine one pose, but a law needs {LEAST_VIEWS}: give "
            "more views, or more or larger tags.",
            "views",
        )

    def fitted(own: BoolArray) -> PowerLaw:
        own = own if own.sum() >= LEAST_VIEWS else np.ones_like(own)
        return fit_power(distance[own], tags[own], deviation[own])

    return Law(fitted(tags == 1), fitted(tags > 1))


def fit_rule(shape: str, distance: FloatArray, tags: IntArray, deviation: FloatArray) -> Rule:
    """Fit the scale of a rule to the standard deviations of the position or rotation in V views.

    The ratios of the standard deviations to the rule then have the mean square 1, as for power laws.

    Args:
        shape: name of the rule, a key of `RULES`.
        distance: mean distance of the tags in each view, metres, `(V,)`.
        tags: number of tags in each view, `(V,)`.
        deviation: standard deviations, metres or rad, `(V,)`.
    """
    per_view = RULES[shape](distance, tags)

    def fitted(own: BoolArray) -> float:
        own = own if shape in BY_NUMBER and own.any() else np.ones_like(own)
        return _scale(deviation[own], per_view[own])

    return Rule(shape, fitted(tags == 1), fitted(tags > 1))


def ratio_quantiles(deviation: FloatArray, predicted: FloatArray) -> dict[str, float]:
    """Quantiles over V views of the ratio `deviation` / `predicted`.

    Both arguments are standard deviations, `(V,)`; `predicted` is according to a law. The quantiles at the
    probabilities `LEVELS` have keys such as `50 %`. One more number has the key `factor_90`: 90 % of the ratios are
    between 1 / `factor_90` and `factor_90`.
    """
    ratio = deviation / predicted
    found = {
        f"{100 * level:g} %": float(value) for level, value in zip(LEVELS, np.quantile(ratio, LEVELS), strict=True)
    }
    return found | {"factor_90": float(np.exp(np.quantile(np.abs(np.log(ratio)), 0.9)))}
