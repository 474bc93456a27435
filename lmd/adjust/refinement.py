"""Refinement: joint estimate of all poses and of nuisance parameters (intrinsics, shifts of corners, shapes of tags).

All nuisance parameters have priors, so that the covariance of the poses accounts for them.

- *Intrinsics* theta: a corner p that is detected at x has the residual e = pi(p, theta) - x, where pi is the
  projection. The derivative of e with respect to theta is d pi(p, theta) / d theta. Each step recomputes the directions
  of the corners with the present intrinsics.
- *Shifts*: blur and exposure move all edges in the images of a camera inward or outward by s_1 + s_2 (2 / pitch)^2
  pixels. The pitch is the number of pixels per module of the tag. The shift adds to the detector's measured shift, and
  makes tags look smaller or larger.
- *Shapes* are deformations of tags, see `lmd.adjust.sightings.SHAPES`. The standard deviation of shapes is estimated by
  expectation-maximisation: its square is the mean, over modes and tags, of the squared estimate plus the estimate's
  variance.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.corners import Poses, Reprojection, fitting
from lmd.adjust.estimate import FLOOR_PIXELS, Estimate, Lenses, constraining, inflation
from lmd.adjust.intrinsics import Optics, parameter_slopes, prior_sigmas
from lmd.adjust.motion import HIDDEN, SURE, Clock
from lmd.adjust.sightings import MODES, RESIDUALS, Observations, Sightings, shift_basis
from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.detection.corner_errors import inward, shortest_side

SMALL_SHARE = 0.5  # prior standard deviation of the second shift, as a share of that of the first
SHAPE_SIGMA, LEAST_SHAPE_SIGMA = 3e-4, 1e-5  # initial and minimum standard deviation of shapes, metres
PASSES = 2  # number of passes; the second pass uses the inflation from blocks of time
MOST_ROUNDS, ROUND_STEPS = 12, 3  # maximum number of rounds, and steps of bundle adjustment in each round
MOST_TRIALS, FIRST_DAMPING = 6, 1e-3  # maximum number of trials of a step, with increasing damping, and first damping
SLACK = 1e-3  # maximum increase of the loss by an accepted step
SETTLED_SIGMAS = 0.3  # the rounds end when a step is smaller than this, in standard deviations
SETTLED_SHAPES = 0.1  # the rounds end when the standard deviation of shapes changes by less than this, relative
NEAR_PIXELS = 5.0  # maximum error, pixels, of tags whose edges are taken from their poses
# The edge is doubted if its relative error exceeds `LEAST_GROWTH` and `SURE_SIGMAS` standard deviations. The prior
# standard deviation is `GROWTH_SIGMA`. At least `FEWEST_SCALED` tags with known poses are needed.
LEAST_GROWTH, SURE_SIGMAS, GROWTH_SIGMA, FEWEST_SCALED = 0.004, 4.0, 0.1, 3
# Number of corrections of the clock; minimum share of the variance of velocities that is motion and not drift.
CLOCK_ROUNDS, LEAST_SHOWN = 4, 1.0 / 3.0
MOST_HALVINGS = 6  # maximum number of halvings of a step that leads to invalid cameras


def _never(_done: int, _most: int) -> bool:
    """Return False before each round, so that the refinement is never stopped."""
    return False


def with_lenses(found: Estimate, seen: Observations, is_rough: bool = False) -> Estimate:
    """Estimate with the nuisance parameters of cameras (intrinsics and shifts of corners) as unknowns. These unknowns
    begin at their prior means, which are those of the given cameras.

    Args:
        found: estimate with the given cameras.
        seen: detections.
        is_rough: True if the given intrinsics are a rough guess.
    """
    shift = [seen.errors.inward_spread, SMALL_SHARE * seen.errors.inward_spread]
    sigmas = tuple(np.append(prior_sigmas(one.camera, is_rough), shift) for one in seen.optics)
    width = 6 * -(-max(map(len, sigmas)) // 6)  # rounded up to a multiple of 6
    lenses = Lenses(seen, seen.optics, sigmas, np.zeros((len(sigmas), width)))
    flat = replace(found.sightings, shape_sigma=SHAPE_SIGMA)
    return _through(replace(found, sightings=flat), lenses)


def _lenses_of(found: Estimate) -> Lenses:
    assert found.lenses is not None
    return found.lenses


def _through(found: Estimate, lenses: Lenses) -> Estimate:
    """Copy of the estimate whose cameras have the nuisance parameters `lenses`. The sightings are computed again with
    these cameras; the shapes of tags are kept.
    """
    names = ("edges", "shapes", "shape_sigma", "size_sigmas", "taken")
    some = replace(lenses.seen.through(lenses.optics), **{name: getattr(found.sightings, name) for name in names})
    some = with_nuisances(some, lenses.optics, lenses.sigmas, found.poses)
    return replace(found, sightings=some, lenses=lenses)


def nuisances_off(found: Estimate) -> FloatArray:
    """Nuisance parameters minus their prior means, in prior standard deviations, `(n, 6)`. The first rows are those of
    cameras, the others those of the shapes of tags.
    """
    if found.lenses is None:
        return np.zeros((0, 6))
    some, cameras = found.sightings, found.lenses.off.reshape(-1, 6)
    return np.concatenate([cameras, some.shapes / np.maximum(some.shape_sigmas, LEAST_SHAPE_SIGMA)])


def minimised(found: Estimate, is_stopped: Callable[[int, int], bool] = _never) -> Estimate:
    """Estimate with the poses and nuisance parameters that minimise the loss, found in rounds. A round first improves
    the poses, then takes one joint Levenberg-Marquardt step of all unknowns. The rounds end when the changes of the
    nuisance parameters in a round are small.

    Args:
        found: estimate with nuisance parameters of the cameras as unknowns.
        is_stopped: function that is called before each round, with the number of finished rounds and the maximum number
            of rounds; it returns True to stop.
    """
    now, damping, cameras = found, 0.0, _lenses_of(found).off.size // 6
    for done in range(MOST_ROUNDS):
        some, squares = now.sightings, now.squares
        used = (now.group[some.tag] == 0) & np.isfinite(squares) & fitting(some, squares, now.floor)
        used = constraining(some, used, now.prior)
        if is_stopped(done, MOST_ROUNDS) or not used.any():
            break
        joint = Adjustment(some.of(used), now.prior, True, now.inflation)
        rest = Adjustment(joint.sightings, now.prior, False, now.inflation)
        poses, floor = rest.run(now.poses, now.floor, ROUND_STEPS, FLOOR_PIXELS)
        now = replace(now, poses=poses, floor=floor)
        if (tried := _stepped(now, joint, used, damping)) is None:
            break
        now, step, variance, damping = tried
        some = now.sightings
        spread = (some.shapes / some.shape_sigma) ** 2 + variance[cameras:] / now.inflation**2
        grown = float(np.sqrt(spread[joint.sightings.counts() > 0, :MODES].mean()))
        taken = float((1.0 - joint.nuisance_information[:, None] * variance).sum())
        sigma = max(grown * some.shape_sigma, LEAST_SHAPE_SIGMA)
        now = replace(now, sightings=replace(some, shape_sigma=sigma, taken=taken))
        is_settled = (step[:cameras] ** 2 <= SETTLED_SIGMAS**2 * variance[:cameras]).all()
        if is_settled and abs(grown - 1.0) < SETTLED_SHAPES:
            break
    return now


def _stepped(
    found: Estimate, joint: Adjustment, used: BoolArray, damping: float
) -> tuple[Estimate, FloatArray, FloatArray, float] | None:
    """Change poses and nuisance parameters together by one Levenberg-Marquardt step. The damping is raised until the
    loss does not increase.

    Args:
        found: estimate before the step.
        joint: bundle adjustment of the inliers, with nuisance parameters as unknowns.
        used: mask of the inliers, `(N,)`.
        damping: relative increase of the diagonal of the normal matrix that is tried first.

    Returns:
        estimate after the step; changes of the nuisance parameters, and their variances, `(n, 6)` each; damping to try
        first in the next call. None if the loss increases with every damping that is tried.
    """

    def loss(one: Estimate, some: Sightings | None = None) -> float:
        """Loss of the sightings and of all priors at the poses and nuisance parameters of the estimate `one`. The
        sightings are `some`, or those of `joint` if None.
        """
        nuisances = 0.5 * float((joint.nuisance_information[:, None] * nuisances_off(one) ** 2).sum())
        return nuisances + joint.loss(one.poses, found.floor, some)

    most = loss(found) + SLACK
    for _ in range(MOST_TRIALS):
        there, step, covariance = joint.joint_step(found.poses, found.floor, damping, nuisances_off(found))
        tried = _after(found, step, there)
        some = tried.sightings
        # Another lens may exclude other corners from its image; losses can then not be compared.
        if len(some) != len(used) or loss(tried, some.of(used)) <= most:
            return tried, step, np.diag(covariance).reshape(-1, 6), damping / 10.0
        damping = max(10.0 * damping, FIRST_DAMPING)
    return None


def _after(found: Estimate, step: FloatArray, poses: Poses) -> Estimate:
    """Estimate with the poses `poses`, and with nuisance parameters changed by `step` `(n, 6)`, in prior standard
    deviations. The part of the step that changes cameras is halved until the changed cameras are valid.
    """
    lenses, some = _lenses_of(found), found.sightings
    cameras = lenses.off.size // 6
    shaped = replace(some, shapes=some.shapes + some.shape_sigmas * step[cameras:])
    for halving in range(MOST_HALVINGS + 1):
        factor = 0.5**halving if halving < MOST_HALVINGS else 0.0
        off = lenses.off + factor * step[:cameras].reshape(lenses.off.shape)
        rows = zip(lenses.seen.optics, lenses.sigmas, off, strict=True)
        try:
            optics = tuple(one.at(one.values + row[: len(sigma)] * sigma) for one, sigma, row in rows)
        except InputError:
            continue
        return _through(replace(found, sightings=shaped, poses=poses), replace(lenses, optics=optics, off=off))
    raise AssertionError("the present cameras are valid")


def with_nuisances(
    sightings: Sightings, optics: Sequence[Optics], sigmas: Sequence[FloatArray], poses: Poses
) -> Sightings:
    """Sightings with the derivatives of their residuals with respect to the nuisance parameters of the cameras.

    Args:
        sightings: sightings, computed with `optics`.
        optics: optics of each camera.
        sigmas: for each camera, prior standard deviations of its intrinsics and shifts, `(P + 2,)`.
        poses: all poses. Derivatives are taken at the projected corners of tags with a pose. Derivatives at detected
            corners would have the noise of the residuals, and bias the parameters.
    """
    at = Reprojection(sightings, *poses.of(sightings))
    error = at.error.reshape(-1, 4, 2)
    is_near = np.abs(error).max(axis=(1, 2), keepdims=True) < NEAR_PIXELS
    image = np.where(is_near, sightings.image + error, sightings.image)
    directions = np.where(is_near, at.directions, sightings.directions)
    pitch = shortest_side(image) * sightings.pitch / sightings.sizes
    lens = np.zeros((len(sightings), 4, 2, 6 * -(-max(map(len, sigmas)) // 6)))
    for index, (one, sigma) in enumerate(zip(optics, sigmas, strict=True)):
        own, size = sightings.camera == index, len(sigma)
        lens[own, ..., : size - 2] = parameter_slopes(one.camera, directions[own])
        lens[own, ..., size - 2 : size] = inward(image[own])[..., None] * shift_basis(pitch[own])[:, None, None, :]
        lens[own, ..., :size] *= sigma
    return replace(sightings, lens=lens.reshape(len(sightings), RESIDUALS, -1))


def refine(
    found: Estimate,
    keep: bool = False,
    is_stopped: Callable[[int, int], bool] = _never,
) -> Estimate:
    """Estimate poses and nuisance parameters (intrinsics, shifts of corners, shapes of tags) together.

    Args:
        found: estimate with nuisance parameters as unknowns, as `with_lenses` returns.
        keep: True to keep cameras and shapes as they are; their uncertainty still enters the covariance.
        is_stopped: function that is called before each round of adjustment, with the number of finished rounds and the
            maximum number of rounds; it returns True to stop with the present estimate.
    """
    for _ in range(PASSES):
        found = found if keep else minimised(found, is_stopped)
        found = _through(found, _lenses_of(found)).adjusted()
        if found.inflation > 1.0 or (grown := inflation(found)) == 1.0:
            break
        found = replace(found, inflation=grown)
    return found


def _more_unknowns(found: Estimate, slopes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Normal equations of k <= 6 additional unknowns that are common to all images; other unknowns are eliminated.

    The images of each camera give one estimate of the additional unknowns. The estimates from all cameras are averaged
    with the inverse of their joint covariance.

    Args:
        found: estimate with poses.
        slopes: derivatives of the inliers' residuals with respect to the additional unknowns, `(n, 8, k)`. The unit of
            an unknown is its prior standard deviation.

    Returns:
        matrix `(k, k)` and right side `(k,)` of the normal equations.
    """
    used, count = found.sightings.of(found.used), slopes.shape[2]
    wider = np.concatenate([used.lens, np.pad(slopes, ((0, 0), (0, 0), (0, 6 - count)))], axis=2)
    joint = Adjustment(replace(used, lens=wider), found.prior, True, found.inflation)
    last, cameras = joint.lens_blocks - 1, np.arange(used.cameras)  # unknowns are in the last block of each camera
    off = np.insert(nuisances_off(found), last * (cameras + 1), 0.0, axis=0)
    _, step, covariance = joint.joint_step(found.poses, found.floor, 0.0, off)
    each = (6 * (last + joint.lens_blocks * cameras[:, None]) + np.arange(count)).ravel()
    shared = np.tile(np.eye(count), (len(cameras), 1))
    weights = np.linalg.solve(covariance[np.ix_(each, each)], shared)
    return weights.T @ shared, weights.T @ step.ravel()[each]


def synchronised(found: Estimate, again: Callable[[Estimate], Estimate]) -> Estimate:
    """Estimate with the offset of the camera's clock from the odometry's clock, see `Clock`. If this offset is
    significant, the poses are adjusted again with odometry at the corrected times.

    Args:
        found: adjusted estimate.
        again: function that adjusts an estimate whose motion model has changed.
    """
    for _ in range(CLOCK_ROUNDS):
        motion, clock = found.prior.motion, _clock(found)
        found = replace(found, clock=clock)
        if clock is None or motion is None:
            break
        is_significant = clock.sigma < HIDDEN and abs(clock.offset) > SURE * clock.sigma
        offset = clock.offset if is_significant else 0.0
        if abs(offset - motion.offset) <= SETTLED_SIGMAS * clock.sigma * is_significant:
            break
        found = again(replace(found, prior=replace(found.prior, motion=motion.shifted(offset))))
    return found


def _clock(found: Estimate) -> Clock | None:
    """Estimate the offset of the odometry's clock from the camera's clock; None without odometry. The prior standard
    deviation of the offset is one second.

    If the camera's clock is behind, images show the body farther along its way than at their times. So the derivative
    of the residuals with respect to the offset is their derivative with respect to the body's pose, times the body's
    velocity.

    Drift of odometry looks like changes of the velocity, and would make the offset seem known where the velocity is
    constant. The velocities from even and from odd steps of odometry have independent drift. So the product of the two
    derivatives, one with each velocity, has only the information that the motion contains (instrumental variables).
    """
    motion, used = found.prior.motion, found.sightings.of(found.used)
    if motion is None or motion.odometry is None or not len(used):
        return None
    by_frame = Reprojection(used, *found.poses.of(used)).by_frame
    information, right = _more_unknowns(found, by_frame @ motion.velocities[used.frame])
    shown, whole = information[0, 1], information.mean()
    more, sigma = (right.mean() / shown, np.sqrt(whole) / shown) if shown > LEAST_SHOWN * whole else (0.0, 1.0)
    return Clock(motion.offset + float(more), float(sigma), motion.offset != 0.0)


def edge_doubts(found: Estimate) -> list[str]:
    """List with one sentence that doubts the stated edge length of the tags; empty if there is no reason for doubt.

    The edge length is doubted if another edge length of all tags explains the images and the known poses better. The
    growth common to all tags is estimated as one more unknown. This growth differs from a shift of edges by blur:
    larger edges move corners outward in proportion to the size of a tag in the image.

    Args:
        found: result of `refine`.
    """
    used = found.sightings.of(found.used)
    known = found.prior.information[:, 3:].all(axis=1) & (found.group == 0)
    if known.sum() < FEWEST_SCALED or not len(used):
        return []  # only the tags have a scale
    by_size = Reprojection(used, *found.poses.of(used)).by_size
    information, right = (each.item() for each in _more_unknowns(found, GROWTH_SIGMA * by_size))
    growth, sigma = GROWTH_SIGMA * right / information, GROWTH_SIGMA * information**-0.5
    if abs(growth) < max(LEAST_GROWTH, SURE_SIGMAS * sigma):
        return []
    edge, way = 1e3 * float(np.median(used.edges)), "larger" if growth > 0.0 else "smaller"
    better = (
        f"tags that are {100.0 * abs(growth):.1g} % {way} than {edge:.4g} mm explain images and known places better"
    )
    return [f"{better}: measure the edge of a tag"]
