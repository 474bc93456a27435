"""Nuisance parameters of a survey: intrinsics of cameras, shifts of corners by the detector, shapes of tags.

All nuisance parameters have priors and are estimated together with the map, so that the covariance of the map accounts
for them.

- *Intrinsics* theta: a corner p that is found at x has the residual e = pi(p, theta) - x, where pi is the projection.
  The derivative of e by theta is d pi(b, theta) / d theta at the direction b of x. Each step recomputes the directions.
- *Shifts*: blur and exposure move the edges of all tags in the images of a camera inward or outward by s_1 + s_2 (2 /
  pitch)^2 pixels, in addition to the measured shift of the detector. Tags then look smaller or larger.
- *Shapes*: see `lmd.survey.sightings.SHAPES`. The standard deviation of shapes is estimated by
  expectation-maximisation, as the root of the mean of squares plus variances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.core.checks import FloatArray, InputError
from lmd.detection.corner_errors import inward, shortest_side
from lmd.geometry.camera import Camera
from lmd.survey.initialisation import FLOOR_PIXELS
from lmd.survey.intrinsics import intrinsics_of, parameter_slopes, with_intrinsics
from lmd.survey.linked_adjustment import adjustment_of, constraining
from lmd.survey.map_estimate import ONE_THREAD, Estimate, adjust, fitting
from lmd.survey.resampling import inflation
from lmd.survey.residuals import Poses, Reprojection, squared_errors, student_loss
from lmd.survey.sightings import MODES, RESIDUALS, Sightings, shift_basis

SMALL_SHARE = 0.5  # prior standard deviation of the second shift, over the prior standard deviation of the first shift
SHAPE_SIGMA, LEAST_SHAPE_SIGMA = 3e-4, 1e-5  # first and least standard deviation of shapes, metres
PASSES = 2  # number of passes; the second pass uses the inflation by blocks of time
MOST_ROUNDS, ROUND_STEPS = 12, 3  # rounds, and steps of bundle adjustment in each round
MOST_TRIALS, FIRST_DAMPING = 6, 1e-3  # trials of a step with increasing damping, and the first damping
SLACK = 1e-3  # maximum increase of the loss by an accepted step
SETTLED_SIGMAS = 0.3  # the rounds end when a step is smaller, in standard deviations
SETTLED_SHAPES = 0.1  # the rounds end when the standard deviation of shapes changes by less, relative
NEAR_PIXELS = 5.0  # maximum error, pixels, of tags whose edges are taken from their poses
# Another edge is tried `EDGE_ROUNDS` times if it differs by `LEAST_GROWTH`, relative, and `FEWEST_SCALED` tags tell the
# scale. An explanation is better if its loss is smaller by `BETTER`, a log-likelihood.
EDGE_ROUNDS, LEAST_GROWTH, FEWEST_SCALED, BETTER = 3, 0.004, 3, 10.0
SMALLEST_M, LEAST_SHIFT = 1e-3, 1e-3  # least distance of tags, metres, and prior standard deviation of shifts, pixels
MOST_HALVINGS = 6  # maximum number of halvings of a step that leads to no valid camera


@dataclass(frozen=True)
class Optics:
    """Camera, and the shift of edges in its images."""

    camera: Camera
    """The camera."""
    shifts: tuple[float, float] = (0.0, 0.0)
    """Shifts s_1 and s_2 inward, pixels."""

    @property
    def values(self) -> FloatArray:
        """Intrinsics and shifts, `(P + 2,)`."""
        return np.append(intrinsics_of(self.camera), self.shifts)

    def at(self, values: FloatArray) -> "Optics":
        """Optics with other values.

        Raises:
            InputError: no camera has these intrinsics.
        """
        return Optics(with_intrinsics(self.camera, values[:-2]), (float(values[-2]), float(values[-1])))


def with_nuisances(
    sightings: Sightings, optics: Sequence[Optics], sigmas: Sequence[FloatArray], poses: Poses
) -> Sightings:
    """Sightings with the derivatives by their cameras' nuisance parameters.

    Args:
        sightings: sightings through `optics`.
        optics: optics of each camera.
        sigmas: prior standard deviations of the values of each camera, `(P + 2,)`.
        poses: all poses. Shifts are computed from the edges of the posed tags: detected edges share the noise of the
            residuals and would bias the shifts.
    """
    image, error = sightings.image, Reprojection(sightings, *poses.of(sightings)).error.reshape(-1, 4, 2)
    image = np.where(np.abs(error).max(axis=(1, 2), keepdims=True) < NEAR_PIXELS, image + error, image)
    pitch = shortest_side(image) * sightings.pitch / sightings.sizes
    lens = np.zeros((len(sightings), 4, 2, _width(sigmas)))
    for index, (one, sigma) in enumerate(zip(optics, sigmas, strict=True)):
        own, size = sightings.camera == index, len(sigma)
        lens[own, ..., : size - 2] = parameter_slopes(one.camera, sightings.directions[own])
        lens[own, ..., size - 2 : size] = inward(image[own])[..., None] * shift_basis(pitch[own])[:, None, None, :]
        lens[own, ..., :size] *= sigma
    return replace(sightings, lens=lens.reshape(len(sightings), RESIDUALS, -1))


def _width(sigmas: Sequence[FloatArray]) -> int:
    """Number of nuisance parameters of the cameras, filled up to a multiple of 6."""
    return 6 * -(-max(map(len, sigmas)) // 6)


def refine(
    found: Estimate,
    given: Sequence[Optics],
    sigmas: Sequence[FloatArray],
    sighted: Callable[[Sequence[Optics]], Sightings],
    keep: bool,
    is_stopped: Callable[[int, int], bool],
    on_block: Callable[[int, int], object],
) -> tuple[Estimate, tuple[Optics, ...]]:
    """Estimate poses and nuisance parameters together.

    Args:
        found: estimate with the given cameras.
        given: the given cameras.
        sigmas: prior standard deviations of the values of each camera, `(P + 2,)`.
        sighted: sightings through other optics.
        keep: True to keep cameras and shapes; their uncertainty still counts.
        is_stopped: called before each round with its number and the most rounds; True to stop with the present state.
        on_block: called with the number of finished blocks of time, and the number of all blocks.
    """
    refinement = _Refinement(given, sigmas, sighted, is_stopped)
    state = _State.of(given, sigmas, len(found.group))
    for _ in range(PASSES):
        if not keep:
            state, found = refinement.minimised(state, found)
        factor, some = found.inflation, refinement.sightings(state, found)
        found = adjust(some, found.prior, found.poses, found.group, FLOOR_PIXELS, factor)
        if factor > 1.0 or (grown := inflation(found, on_block)) == 1.0:
            break
        found = replace(found, inflation=grown)
    return found, state.optics


def edge_doubts(
    found: Estimate,
    optics: Sequence[Optics],
    given: Sequence[Optics],
    sigmas: Sequence[FloatArray],
    sighted: Callable[[Sequence[Optics]], Sightings],
) -> list[str]:
    """Sentence on the edge of all tags, if another one explains the images and the known places at least as well.

    The estimate is made again with the edges that the shift of corners and the scale of the map suggest. Larger edges
    move corners outward in proportion to the size of a tag in the image; a shift is alike near and far.

    Args:
        found, optics: result of `refine`.
        given, sigmas, sighted: arguments of `refine`.
    """
    known = np.flatnonzero(found.prior.information[:, 3:].all(axis=1) & (found.group == 0))
    if len(known) < FEWEST_SCALED:
        return []  # nothing but the tags has a scale
    first, second = np.triu_indices(len(known), 1)
    tried, through, growth = found, tuple(optics), 0.0
    for _ in range(EDGE_ROUNDS):
        places = np.stack([tried.prior.tags[known, :3, 3], tried.poses.tags[known, :3, 3]])
        expected, mapped = np.linalg.norm(places[:, first] - places[:, second], axis=2)
        shift = np.array([camera.shifts[0] for camera in through])[tried.sightings.camera]
        outward = float(np.median((-2.0 * shift / tried.sightings.sizes)[tried.used]))
        more = float(np.log(np.median(expected / np.maximum(mapped, SMALLEST_M)))) + outward
        if abs(more) < LEAST_GROWTH:
            break
        growth += more
        some = replace(sighted(given), edges=found.sightings.edges * np.exp(growth))
        tried = adjust(some, found.prior, found.poses, found.group, FLOOR_PIXELS)
        tried, through = refine(tried, given, sigmas, sighted, False, lambda _done, _most: False, lambda *_: None)
    if abs(growth) < LEAST_GROWTH:
        return []
    before, after = (_loss(*one, sigmas, found.floor) for one in ((found, optics), (tried, through)))
    if after > before + BETTER:
        return []
    was, edge = (1e3 * float(np.median(state.sightings.edges)) for state in (found, tried))
    most = max((one.shifts[0] for one in optics), key=abs)
    way = f"corners {abs(most):.2g} pixels {'inward' if most > 0.0 else 'outward'} do"
    how = "better than" if after < before - BETTER else "as well as"
    explained = f"tags with {edge:.4g} mm in place of {was:.4g} mm explain images and known places"
    return [f"{explained} {how} {way}: measure the edge of a tag"]


def _loss(found: Estimate, optics: Sequence[Optics], sigmas: Sequence[FloatArray], floor: float) -> float:
    """Loss of sightings, prior poses and shifts of corners."""
    square = squared_errors(found.sightings, found.poses) / found.sightings.variance(floor)
    placed = np.isfinite(square) & (found.group[found.sightings.tag] == 0)
    off = [
        np.array(one.shifts) / np.maximum(sigma[-2:], LEAST_SHIFT) for one, sigma in zip(optics, sigmas, strict=True)
    ]
    priors = found.prior.loss(found.prior.off(found.poses.tags)) + 0.5 * float(np.square(off).sum())
    return student_loss(square[placed]) + priors


class _State(NamedTuple):
    """Nuisance parameters."""

    optics: tuple[Optics, ...]
    """Optics of the cameras."""
    off: FloatArray
    """`(C, 6 L)` distance of the cameras' values from the given values, in prior standard deviations."""
    shapes: FloatArray
    """`(K, 6)` shapes of tags, see `Sightings`."""
    shape_sigma: float
    """Standard deviation of shapes, metres."""
    taken: float
    """Degrees of freedom, see `Sightings`."""

    @classmethod
    def of(cls, given: Sequence[Optics], sigmas: Sequence[FloatArray], tags: int) -> "_State":
        """State with the given cameras and with flat tags."""
        return cls(tuple(given), np.zeros((len(given), _width(sigmas))), np.zeros((tags, 6)), SHAPE_SIGMA, 0.0)

    @property
    def units(self) -> FloatArray:
        """Distances of all parameters from their prior means, in prior standard deviations, `(n, 6)`."""
        return np.concatenate([self.off.reshape(-1, 6), self.shapes / self.shape_sigma])

    def loss(self, information: FloatArray) -> float:
        """Loss of the priors, see `SchurSystem.nuisance_information`."""
        return 0.5 * float((information[:, None] * self.units**2).sum())


@dataclass(frozen=True)
class _Refinement:
    """Arguments of `refine`."""

    given: Sequence[Optics]
    sigmas: Sequence[FloatArray]
    sighted: Callable[[Sequence[Optics]], Sightings]
    is_stopped: Callable[[int, int], bool]

    def sightings(self, state: _State, found: Estimate) -> Sightings:
        """Sightings with nuisance parameters, with the shifts at the poses of `found`."""
        some = replace(
            self.sighted(state.optics),
            edges=found.sightings.edges,
            shapes=state.shapes,
            shape_sigma=state.shape_sigma,
            taken=state.taken,
        )
        return with_nuisances(some, state.optics, self.sigmas, found.poses)

    def minimised(self, state: _State, found: Estimate) -> tuple[_State, Estimate]:
        """Take joint steps of all unknowns until the steps are small."""
        damping, sightings = 0.0, self.sightings(state, found)
        with threadpool_limits(limits=ONE_THREAD):
            for done in range(MOST_ROUNDS):
                if self.is_stopped(done, MOST_ROUNDS):
                    break
                error = squared_errors(sightings, found.poses)
                of_map = (found.group[sightings.tag] == 0) & np.isfinite(error)
                used = of_map & fitting(sightings, error, found.floor)
                used = constraining(sightings, used, found.prior.motion)
                if not used.any():
                    break
                joint = adjustment_of(sightings.of(used), found.prior, True, found.inflation)
                rest = adjustment_of(joint.sightings, found.prior, False, found.inflation)
                poses, floor = rest.run(found.poses, found.floor, ROUND_STEPS, FLOOR_PIXELS)
                found = replace(found, poses=poses, floor=floor)
                error, information = squared_errors(joint.sightings, poses), joint.nuisance_information
                loss = state.loss(information) + joint.loss(error, joint.prior_losses(poses), floor)
                for _ in range(MOST_TRIALS):
                    there, step, variance = joint.joint_step(poses, floor, damping, state.units)
                    tried = self._stepped(state, step)
                    sightings = self.sightings(tried, replace(found, poses=there))
                    if len(sightings) != len(used):
                        break  # the new lens images other corners, so losses cannot be compared
                    error = squared_errors(sightings.of(used), there)
                    loss_there = joint.loss(error, joint.prior_losses(there), floor)
                    if tried.loss(information) + loss_there <= loss + SLACK:
                        break
                    damping = max(10.0 * damping, FIRST_DAMPING)
                else:
                    break
                found, damping = replace(found, poses=there), damping / 10.0
                lenses = state.off.size // 6
                placed = joint.sightings.counts() > 0
                squares = (tried.shapes / tried.shape_sigma) ** 2 + variance[lenses:] / found.inflation**2
                grown = float(np.sqrt(squares[placed, :MODES].mean()))
                taken = float((1.0 - information[:, None] * variance).sum())
                state = tried._replace(shape_sigma=max(grown * tried.shape_sigma, LEAST_SHAPE_SIGMA), taken=taken)
                sightings = replace(sightings, shape_sigma=state.shape_sigma, taken=taken)
                is_settled = (step[:lenses] ** 2 <= SETTLED_SIGMAS**2 * variance[:lenses]).all()
                if is_settled and abs(grown - 1.0) < SETTLED_SHAPES:
                    break
        return state, found

    def _stepped(self, state: _State, step: FloatArray) -> _State:
        """State after a step `(n, 6)`; the step of the optics is halved until it leads to valid cameras."""
        lenses = state.off.size // 6
        shapes = state.shapes + state.shape_sigma * step[lenses:]
        for halving in range(MOST_HALVINGS + 1):
            factor = 0.5**halving if halving < MOST_HALVINGS else 0.0
            there = state.off + factor * step[:lenses].reshape(state.off.shape)
            rows = zip(self.given, self.sigmas, there, strict=True)
            try:
                optics = tuple(one.at(one.values + row[: len(sigma)] * sigma) for one, sigma, row in rows)
            except InputError:
                continue
            return state._replace(optics=optics, off=there, shapes=shapes)
        raise AssertionError("the present cameras are valid")
