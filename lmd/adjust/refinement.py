"""Refinement: nuisance parameters are estimated together with all poses.

All nuisance parameters have priors, so that the covariance of the poses accounts for them.

- *Intrinsics* theta: a corner p that is found at x has the residual e = pi(p, theta) - x, where pi is the projection.
  The derivative of e by theta is d pi(p, theta) / d theta. Each step recomputes the directions.
- *Shifts*: blur and exposure move the edges of all tags in the images of a camera inward or outward by s_1 + s_2 (2 /
  pitch)^2 pixels, in addition to the measured shift of the detector. Tags then look smaller or larger.
- *Shapes*: see `lmd.adjust.sightings.SHAPES`. The standard deviation of shapes is estimated by
  expectation-maximisation, as the root of the mean of squares plus variances.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from threadpoolctl import threadpool_limits

from lmd.adjust.adjustment import Adjustment
from lmd.adjust.corners import Poses, Reprojection, student_loss
from lmd.adjust.estimate import FLOOR_PIXELS, ONE_THREAD, Estimate, adjust, constraining, inflation
from lmd.adjust.intrinsics import Calibrated, Optics, parameter_slopes, prior_sigmas
from lmd.adjust.noise import fitting
from lmd.adjust.sightings import MODES, RESIDUALS, Observations, Sightings, shift_basis
from lmd.core.checks import BoolArray, FloatArray, InputError
from lmd.detection.corner_errors import inward, shortest_side

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


def _never(_done: int, _most: int) -> bool:
    """Return False: a refinement is not stopped."""
    return False


@dataclass(frozen=True)
class Refined:
    """Estimate with nuisance parameters."""

    seen: Observations
    """Detections, and the given cameras."""
    sigmas: tuple[FloatArray, ...]
    """Prior standard deviations of each camera's values, see `Optics.values`, `(P + 2,)`."""
    found: Estimate
    """Poses; its sightings have the shapes of tags."""
    optics: tuple[Optics, ...]
    """Refined optics of the cameras."""
    off: FloatArray
    """`(C, 6 L)` distance of the cameras' values from the given values, in prior standard deviations."""

    @classmethod
    def begin(cls, found: Estimate, seen: Observations, is_rough: bool = False) -> "Refined":
        """Begin with the given cameras and with flat tags.

        Args:
            found: estimate with the given cameras.
            seen: detections.
            is_rough: True if the given intrinsics are a rough guess.
        """
        shift = [seen.errors.inward_spread, SMALL_SHARE * seen.errors.inward_spread]
        sigmas = tuple(np.append(prior_sigmas(one.camera, is_rough), shift) for one in seen.optics)
        width = 6 * -(-max(map(len, sigmas)) // 6)  # filled up to a multiple of 6
        begun = cls(seen, sigmas, found, seen.optics, np.zeros((len(sigmas), width)))
        flat = replace(found.sightings, shape_sigma=SHAPE_SIGMA)
        return begun._at(seen.optics, begun.off, flat, found.poses)

    @classmethod
    def exact(cls, found: Estimate, seen: Observations) -> "Refined":
        """Exact cameras and flat tags, without nuisance parameters."""
        return cls(seen, (), found, seen.optics, np.zeros((len(seen.optics), 0)))

    def _at(self, optics: Sequence[Optics], off: FloatArray, like: Sightings, poses: Poses) -> "Refined":
        """Sightings through other optics, with the shapes of the sightings `like`, at `poses`."""
        names = ("edges", "shapes", "shape_sigma", "size_sigmas", "taken")
        some = replace(self.seen.through(optics), **{name: getattr(like, name) for name in names})
        some = with_nuisances(some, optics, self.sigmas, poses)
        found = replace(self.found, sightings=some, poses=poses)
        return replace(self, optics=tuple(optics), off=off, found=found)

    @property
    def units(self) -> FloatArray:
        """Distances of all parameters from their prior means, in prior standard deviations, `(n, 6)`."""
        some, cameras = self.found.sightings, self.off.reshape(-1, 6)
        if not some.shape_sigma:
            return cameras
        return np.concatenate([cameras, some.shapes / np.maximum(some.shape_sigmas, LEAST_SHAPE_SIGMA)])

    @property
    def calibrated(self) -> tuple[Calibrated, ...]:
        """Cameras beside the given ones, with their covariances; empty if cameras are exact."""
        if not self.sigmas or not self.found.used.any():
            return ()
        return tuple(
            Calibrated.of(
                given.camera, one.camera, one.shifts[0], own[: len(sigma), : len(sigma)] * np.outer(sigma, sigma)
            )
            for given, one, own, sigma in zip(
                self.seen.optics, self.optics, self.found.lens_covariances, self.sigmas, strict=True
            )
        )

    def surprises(self, least: float) -> list[str]:
        """Sentences on focal lengths and centres that are estimated `least` or more prior standard deviations off."""
        said = []
        for number, (one, off) in enumerate(zip(self.calibrated, self.off, strict=False), 1):
            if np.abs(off[:4]).max() >= least:
                camera = "the camera" if len(self.off) == 1 else f"camera {number}"
                most = f"{np.abs(off[:4]).max():.2g} standard deviations of a calibration"
                said.append(
                    f"{camera} is {most} from the given one ({one.to_text().partition(';')[0]}): is it its own?"
                )
        return said

    def minimised(self, is_stopped: Callable[[int, int], bool] = _never) -> "Refined":
        """Take joint steps of all unknowns until the steps are small."""
        now, damping = self, 0.0
        with threadpool_limits(limits=ONE_THREAD):
            for done in range(MOST_ROUNDS):
                if is_stopped(done, MOST_ROUNDS):
                    break
                found, some = now.found, now.found.sightings
                of_map = (found.group[some.tag] == 0) & np.isfinite(found.squares)
                used = of_map & fitting(some, found.squares, found.floor)
                used = constraining(some, used, found.prior)
                if not used.any():
                    break
                joint = Adjustment(some.of(used), found.prior, True, found.inflation)
                rest = Adjustment(joint.sightings, found.prior, False, found.inflation)
                poses, floor = rest.run(found.poses, found.floor, ROUND_STEPS, FLOOR_PIXELS)
                now = replace(now, found=replace(found, poses=poses, floor=floor))
                if (tried := now._stepped(joint, used, damping)) is None:
                    break
                following, step, variance, damping = tried
                lenses, some = self.off.size // 6, following.found.sightings
                squares = (some.shapes / some.shape_sigma) ** 2 + variance[lenses:] / found.inflation**2
                grown = float(np.sqrt(squares[joint.sightings.counts() > 0, :MODES].mean()))
                taken = float((1.0 - joint.nuisance_information[:, None] * variance).sum())
                sigma = max(grown * some.shape_sigma, LEAST_SHAPE_SIGMA)
                some = replace(some, shape_sigma=sigma, taken=taken)
                now = replace(following, found=replace(following.found, sightings=some))
                is_settled = (step[:lenses] ** 2 <= SETTLED_SIGMAS**2 * variance[:lenses]).all()
                if is_settled and abs(grown - 1.0) < SETTLED_SHAPES:
                    break
        return now

    def _stepped(
        self, joint: Adjustment, used: BoolArray, damping: float
    ) -> tuple["Refined", FloatArray, FloatArray, float] | None:
        """Take one joint step, by the sightings `used`, `(N,)`, with more damping until the loss does not increase.

        Returns:
            state after the step; step of the nuisance parameters and their variances, `(n, 6)` each; next damping. None
            if no damping is enough.
        """
        poses, floor = self.found.poses, self.found.floor
        most = self._nuisance_loss(joint) + joint.loss(poses, floor) + SLACK
        for _ in range(MOST_TRIALS):
            there, step, variance = joint.joint_step(poses, floor, damping, self.units)
            tried = self._after(step, there)
            some = tried.found.sightings
            # A new lens may image other corners; losses can then not be compared.
            is_other = len(some) != len(used)
            if is_other or tried._nuisance_loss(joint) + joint.loss(there, floor, some.of(used)) <= most:
                return tried, step, variance, damping / 10.0
            damping = max(10.0 * damping, FIRST_DAMPING)
        return None

    def _edge_loss(self, floor: float) -> float:
        """Loss of sightings, priors of poses, and shifts of corners."""
        found = self.found
        square = found.squares / found.sightings.variance(floor)
        placed = np.isfinite(square) & (found.group[found.sightings.tag] == 0)
        sigmas = np.array([np.maximum(sigma[-2:], LEAST_SHIFT) for sigma in self.sigmas])
        off = np.array([one.shifts for one in self.optics]) / sigmas
        return student_loss(square[placed]) + found.prior.loss(found.poses) + 0.5 * float((off**2).sum())

    def _nuisance_loss(self, joint: Adjustment) -> float:
        """Loss of the priors of nuisance parameters."""
        return 0.5 * float((joint.nuisance_information[:, None] * self.units**2).sum())

    def _after(self, step: FloatArray, poses: Poses) -> "Refined":
        """State after a step `(n, 6)`; the step of the optics is halved until it leads to valid cameras."""
        lenses, some = self.off.size // 6, self.found.sightings
        some = replace(some, shapes=some.shapes + some.shape_sigmas * step[lenses:])
        for halving in range(MOST_HALVINGS + 1):
            factor = 0.5**halving if halving < MOST_HALVINGS else 0.0
            off = self.off + factor * step[:lenses].reshape(self.off.shape)
            rows = zip(self.seen.optics, self.sigmas, off, strict=True)
            try:
                optics = tuple(one.at(one.values + row[: len(sigma)] * sigma) for one, sigma, row in rows)
            except InputError:
                continue
            return self._at(optics, off, some, poses)
        raise AssertionError("the present cameras are valid")


def with_nuisances(
    sightings: Sightings, optics: Sequence[Optics], sigmas: Sequence[FloatArray], poses: Poses
) -> Sightings:
    """Sightings with the derivatives by their cameras' nuisance parameters.

    Args:
        sightings: sightings through `optics`.
        optics: optics of each camera.
        sigmas: prior standard deviations of the values of each camera, `(P + 2,)`.
        poses: all poses. Derivatives are those at the corners of the posed tags: detected corners share the noise of
            the residuals, which would bias the parameters.
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
    begun: Refined,
    keep: bool = False,
    is_stopped: Callable[[int, int], bool] = _never,
    on_block: Callable[[int, int], object] = _never,
) -> Refined:
    """Estimate poses and nuisance parameters together.

    Args:
        begun: see `Refined.begin`.
        keep: True to keep cameras and shapes; their uncertainty still counts.
        is_stopped: called before each round with its number and the most rounds; True to stop with the present state.
        on_block: called with the number of finished blocks of time, and the number of all blocks.
    """
    now = begun
    for _ in range(PASSES):
        if not keep:
            now = now.minimised(is_stopped)
        now = now._at(now.optics, now.off, now.found.sightings, now.found.poses)
        found = now.found
        found = adjust(found.sightings, found.prior, found.poses, found.group, FLOOR_PIXELS, found.inflation)
        now = replace(now, found=found)
        if found.inflation > 1.0 or (grown := inflation(found, on_block)) == 1.0:
            break
        now = replace(now, found=replace(found, inflation=grown))
    return now


def edge_doubts(now: Refined, is_rough: bool = False) -> list[str]:
    """Sentence on the edge of all tags, if another one explains the images and the known places at least as well.

    The estimate is made again with the edges that the shift of corners and the scale of the map suggest. Larger edges
    move corners outward in proportion to the size of a tag in the image; a shift is alike near and far.

    Args:
        now: result of `refine`.
        is_rough: see `Refined.begin`.
    """
    found, edges = now.found, now.found.sightings.edges
    known = np.flatnonzero(found.prior.information[:, 3:].all(axis=1) & (found.group == 0))
    if len(known) < FEWEST_SCALED:
        return []  # nothing but the tags has a scale
    first, second = np.triu_indices(len(known), 1)
    tried, growth = now, 0.0
    for _ in range(EDGE_ROUNDS):
        places = np.stack([found.prior.tags[known, :3, 3], tried.found.poses.tags[known, :3, 3]])
        expected, mapped = np.linalg.norm(places[:, first] - places[:, second], axis=2)
        some = tried.found.sightings
        shift = np.array([one.shifts[0] for one in tried.optics])[some.camera]
        outward = float(np.median((-2.0 * shift / some.sizes)[tried.found.used]))
        more = float(np.log(np.median(expected / np.maximum(mapped, SMALLEST_M)))) + outward
        if abs(more) < LEAST_GROWTH:
            break
        growth += more
        some = replace(now.seen.through(), edges=edges * np.exp(growth))
        begun = adjust(some, found.prior, found.poses, found.group, FLOOR_PIXELS)
        tried = refine(Refined.begin(begun, now.seen, is_rough))
    if abs(growth) < LEAST_GROWTH:
        return []
    before, after = (one._edge_loss(found.floor) for one in (now, tried))
    if after > before + BETTER:
        return []
    was, edge = (1e3 * float(np.median(one.found.sightings.edges)) for one in (now, tried))
    most = max((one.shifts[0] for one in now.optics), key=abs)
    way = f"corners {abs(most):.2g} pixels {'inward' if most > 0.0 else 'outward'} do"
    how = "better than" if after < before - BETTER else "as well as"
    explained = f"tags with {edge:.4g} mm in place of {was:.4g} mm explain images and known places"
    return [f"{explained} {how} {way}: measure the edge of a tag"]
