"""Nuisance parameters of a survey: the intrinsics of cameras, shifts of corners by the detector, the shapes of tags.

All of these have priors, and are found together with the map, so that what they may be off is in its covariance.

- *Intrinsics* theta: a corner that was found at x and is imaged at pi(p, theta) has e = pi(p, theta) - x. So e changes
  with theta as the image of the direction b does that x was seen in. After each step the directions are those of the
  camera as it then is.
- *Shifts*: blur and exposure move the edges of a tag, and so its corners, inward or outward in all images of a camera,
  by s_1 + s_2 (2 / pitch)^2 pixels beside what is measured of the detector. A tag then looks smaller or larger, the
  more so the smaller it is.
- *Shapes*: see `lmd.survey.sightings.SHAPES`. What their standard deviation is the photographs say themselves: by
  expectation and maximisation, it is the root of the mean of squares and variances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray, InputError
from lmd.geometry.camera import Camera
from lmd.survey.blocks import inflation
from lmd.survey.estimate import ONE_THREAD, Estimate, adjusted, fitting
from lmd.survey.intrinsics import parameters, slopes, with_parameters
from lmd.survey.linked import adjustment_of, telling
from lmd.survey.residuals import Poses, errors_at, gathered, in_cameras, residuals
from lmd.survey.sightings import WAYS, Sightings, inward, shifted, shortest_side
from lmd.survey.stages import Observer, Stage, unobserved
from lmd.survey.start import FLOOR_PIXELS

SMALL_SHARE = 0.5  # of what the first shift may be off, the second one may
SHAPE_SIGMA, LEAST_SHAPE_SIGMA = 3e-4, 1e-5  # metres
PASSES = 2  # the second one with errors that count as they are alike
MOST_ROUNDS, ROUND_STEPS = 12, 3
MOST_TRIALS, FIRST_DAMPING = 6, 1e-3  # of a step that leads uphill
SLACK = 1e-3  # uphill, that is none
SETTLED_SIGMAS = 0.3  # standard deviations; a smaller step is the last
SETTLED_SHAPES = 0.1  # likewise of the deviation of shapes, relative
NEAR_PIXELS = 5.0  # that a corner is off at most where the pose of its tag says how its edges are
MOST_HALVINGS = 6  # of a step that leads to no camera


@dataclass(frozen=True)
class Optics:
    """A camera, and the detector that reads its images.

    Args:
        camera: see there.
        shifts: by how many pixels edges are too far inward, in all tags, and in small ones besides.
    """

    camera: Camera
    shifts: tuple[float, float] = (0.0, 0.0)

    @property
    def values(self) -> FloatArray:
        """The parameters of the camera, and the shifts, `(P + 2,)`."""
        return np.append(parameters(self.camera), self.shifts)

    def at(self, values: FloatArray) -> "Optics":
        """The same with other values.

        Raises:
            InputError: there is no such camera.
        """
        return Optics(with_parameters(self.camera, values[:-2]), (float(values[-2]), float(values[-1])))


Sighted = Callable[[Sequence[Optics]], Sightings]


def freed(
    sightings: Sightings, optics: Sequence[Optics], spreads: Sequence[FloatArray], poses: Poses | None = None
) -> Sightings:
    """The sightings with all that is not known of their cameras unknown.

    Args:
        sightings: through `optics`.
        spreads: what the values of each may be off, `(P + 2,)`.
        poses: of all, where they are known. Shifts are then along the edges where the tags are: along those that were
            found, which hang on the same errors as the residuals, they would have a bias.
    """
    image = sightings.image
    if poses is not None:
        error = residuals(sightings, in_cameras(sightings, *gathered(sightings, poses)))
        image = np.where(np.abs(error).max(axis=(1, 2), keepdims=True) < NEAR_PIXELS, image + error, image)
    pitch = shortest_side(image) * sightings.pitch / sightings.sizes
    most = max(len(spread) for spread in spreads)
    lens = np.zeros((len(sightings), 4, 2, -(-most // 6) * 6))
    for index, (one, spread) in enumerate(zip(optics, spreads, strict=True)):
        own = sightings.camera == index
        lens[own, ..., : len(spread) - 2] = slopes(one.camera, sightings.directions[own])
        way = shifted(pitch[own])[:, None, None, :]
        lens[own, ..., len(spread) - 2 : len(spread)] = inward(image[own])[..., None] * way
        lens[own, ..., : len(spread)] *= spread
    return replace(sightings, lens=lens.reshape(len(sightings), 8, -1))


def refined(
    found: Estimate,
    given: Sequence[Optics],
    spreads: Sequence[FloatArray],
    sighted: Sighted,
    keep: bool = False,
    observer: Observer = unobserved,
) -> tuple[Estimate, tuple[Optics, ...]]:
    """The best poses, cameras and shapes.

    Args:
        found: with the cameras as they were given.
        given: these.
        spreads: what the values of each may be off, `(P + 2,)`.
        sighted: the sightings as other cameras of the same images have them.
        keep: whether cameras and shapes stay as they are given; they are as little known.
        observer: asked before each round whether to stop with what is best so far.
    """
    state = _State.of(given, len(found.group))

    def seen(state: _State, poses: Poses) -> Sightings:
        through = sighted(state.optics)
        own = replace(
            through,
            edges=found.sightings.edges,
            shapes=state.shapes,
            shape_sigma=state.deviation,
            taken=state.taken,
        )
        return freed(own, state.optics, spreads, poses)

    for _ in range(PASSES):
        if not keep:
            state, found = _settled(state, found, given, spreads, seen, observer)
        factor = found.inflation
        found = adjusted(seen(state, found.poses), found.prior, found.poses, found.group, FLOOR_PIXELS, factor)
        if factor > 1.0 or (grown := inflation(found, observer)) == 1.0:
            break
        found = replace(found, inflation=grown)
    return found, state.optics


def _settled(
    state: "_State",
    found: Estimate,
    given: Sequence[Optics],
    spreads: Sequence[FloatArray],
    seen: "Callable[[_State, Poses], Sightings]",
    observer: Observer,
) -> tuple["_State", Estimate]:
    """The state, and the poses, after as many steps of all unknowns together as lead downhill."""
    poses, floor, damping, sightings = found.poses, found.floor, 0.0, seen(state, found.poses)
    with threadpool_limits(limits=ONE_THREAD):
        for done in range(MOST_ROUNDS):
            if observer(Stage.REFINING, done, MOST_ROUNDS):
                break
            error = errors_at(sightings, poses)
            of_map = (found.group[sightings.tag] == 0) & np.isfinite(error)
            used = telling(sightings, of_map & fitting(sightings, error, floor), found.prior.motion)
            if not used.any():
                break
            every = adjustment_of(sightings.of(used), found.prior, True, found.inflation)
            settled = adjustment_of(every.sightings, found.prior, False, found.inflation).run(
                poses, floor, ROUND_STEPS, FLOOR_PIXELS
            )
            poses, floor = settled.poses, settled.floor
            cost = state.cost(every.unit) + every.cost(errors_at(every.sightings, poses), every.costs(poses), floor)
            for _ in range(MOST_TRIALS):
                there, step, variance = every.joint_step(poses, floor, damping, state.units)
                tried = state.stepped(given, spreads, step)
                sightings = seen(tried, there)
                if len(sightings) != len(used):
                    break  # the lens images other corners than before: what they cost does not compare
                error = errors_at(sightings.of(used), there)
                if tried.cost(every.unit) + every.cost(error, every.costs(there), floor) <= cost + SLACK:
                    break
                damping = max(10.0 * damping, FIRST_DAMPING)
            else:
                break
            poses, damping = there, damping / 10.0
            placed = np.bincount(every.sightings.tag, minlength=len(found.group)) > 0
            lenses = state.off.size // 6
            squares = (tried.shapes / tried.deviation) ** 2 + variance[lenses:] / found.inflation**2
            grown = float(np.sqrt(squares[placed, :WAYS].mean()))
            taken = float((1.0 - every.unit[:, None] * variance).sum())
            state = tried._replace(deviation=max(grown * tried.deviation, LEAST_SHAPE_SIGMA), taken=taken)
            sightings = replace(sightings, shape_sigma=state.deviation, taken=taken)
            is_settled = (step[:lenses] ** 2 <= SETTLED_SIGMAS**2 * variance[:lenses]).all()
            if is_settled and abs(grown - 1.0) < SETTLED_SHAPES:
                break
    return state, replace(found, poses=poses, floor=floor)


class _State(NamedTuple):
    """All but the poses, see `Sightings`; `off` is how far the cameras are off those given, `(C, 6 L)`."""

    optics: tuple[Optics, ...]
    off: FloatArray
    shapes: FloatArray
    deviation: float
    taken: float

    @classmethod
    def of(cls, given: Sequence[Optics], tags: int) -> "_State":
        """As it is given: flat tags."""
        width = 6 * -(-max(len(one.values) for one in given) // 6)
        return cls(tuple(given), np.zeros((len(given), width)), np.zeros((tags, 6)), SHAPE_SIGMA, 0.0)

    @property
    def units(self) -> FloatArray:
        """Distances of all from what was known of them, in units of their standard deviations, `(n, 6)`."""
        return np.concatenate([self.off.reshape(-1, 6), self.shapes / self.deviation])

    def cost(self, unit: FloatArray) -> float:
        """The part of the priors in what is minimised, see `Adjustment.unit`."""
        return 0.5 * float((unit[:, None] * self.units**2).sum())

    def stepped(self, given: Sequence[Optics], spreads: Sequence[FloatArray], step: FloatArray) -> "_State":
        """After a step `(n, 6)`, or the first part of it that leads to cameras."""
        lenses = self.off.size // 6
        optics, off = _stepped(given, spreads, self.off, step[:lenses].reshape(self.off.shape))
        return self._replace(optics=optics, off=off, shapes=self.shapes + self.deviation * step[lenses:])


def _stepped(
    given: Sequence[Optics], spreads: Sequence[FloatArray], off: FloatArray, step: FloatArray
) -> tuple[tuple[Optics, ...], FloatArray]:
    """The cameras after a step, or the first part of it that leads to cameras, and how far they are off those given."""

    def at(there: FloatArray) -> tuple[Optics, ...]:
        rows = zip(given, spreads, there, strict=True)
        return tuple(one.at(one.values + row[: len(spread)] * spread) for one, spread, row in rows)

    for halving in range(MOST_HALVINGS):
        there = off + 0.5**halving * step
        try:
            return at(there), there
        except InputError:
            continue
    return at(off), off
