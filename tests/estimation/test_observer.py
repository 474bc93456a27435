import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from lmd.core.checks import InputError
from lmd.estimation.observer import FORMS, Observer
from lmd.estimation.recording import Odometry, Recording
from lmd.geometry import se3
from lmd.geometry.trajectory import Trajectory

RNG = np.random.default_rng(0)
LANDMARKS = RNG.uniform(-3.0, 3.0, (12, 3))
ALL = np.ones(12, dtype=bool)
STEP = 0.08
TWIST = np.array([0.3, -0.5, 0.2, 0.1, 0.4, 0.85])  # round and round: its parts are perpendicular
both_forms = pytest.mark.parametrize("form", FORMS)


def some(*numbers):
    seen = np.zeros(12, dtype=bool)
    seen[list(numbers)] = True
    return seen


def random_pose(angle=1.0):
    direction = RNG.normal(size=3)
    return se3.exp(np.concatenate([direction / np.linalg.norm(direction) * angle, RNG.normal(size=3)]))


def measured(pose, landmarks=LANDMARKS):
    return se3.act(se3.inverse(pose), landmarks)


def corrected(observer, estimate, pose, seen, steps, step=STEP, sign=1.0, landmarks=LANDMARKS):
    """The estimates of a camera that stands still, `(steps + 1, 4, 4)`; damping times `sign`."""
    undamped = Observer(observer.form, observer.gain, 0.0, observer.length)
    path = [estimate]
    for _ in range(steps):
        args = (path[-1], landmarks, measured(pose, landmarks), seen)
        twist = observer.correction(*args)
        if sign != 1.0:
            descent = undamped.correction(*args)
            twist = descent + sign * (twist - descent)
        path.append(path[-1] @ se3.exp(step * twist))
    return np.array(path)


def cost(estimate, landmarks, points, seen):
    """f = 1/2 sum |yh_i - y_i|^2 over the landmarks in view, with k_i = 1, m^2 (Eq. f_without)."""
    error = np.where(seen[..., None], se3.act(se3.inverse(estimate), landmarks) - points, 0.0)
    return 0.5 * (error**2).sum(axis=(-2, -1))


def costs(estimates, pose, seen, landmarks=LANDMARKS):
    return np.array([cost(estimate, landmarks, measured(pose, landmarks), seen) for estimate in estimates])


def recording(poses, seen, step=STEP):
    """One run over all landmarks."""
    time = step * np.arange(len(poses))
    points = measured(poses)
    exact = np.zeros(seen.sum()), np.zeros((seen.sum(), 3, 3))
    motion = Trajectory(time, poses).twists[None], Odometry()
    return Recording(time, poses[None], *motion, LANDMARKS[None], None, seen[None], points[None], *exact)


def moving(frames, twist):
    pose, steps = random_pose(), STEP * np.arange(frames)[:, None] * twist
    return pose @ se3.exp(steps)


@both_forms
@pytest.mark.parametrize("damping", [0.0, 4.0])
def test_the_cost_of_a_static_camera_falls_at_every_step(form, damping):
    for _ in range(6):
        pose = random_pose()
        path = corrected(Observer(form, 16.0, damping), random_pose(), pose, ALL, 100)
        f = costs(path, pose, ALL)
        assert (np.diff(f) <= 1e-12).all()
        assert f[-1] < 1e-3 * f[0]


@both_forms
def test_the_correction_is_the_steepest_descent_of_the_cost(form):
    observer, pose, estimate, seen = Observer(form, damping=0.0), random_pose(), random_pose(), some(0, 3, 4, 7)
    args = (LANDMARKS, measured(pose), seen)
    descent = observer.correction(estimate, *args)
    gain = observer.landmark_gain(*args)
    slopes = []
    for direction in np.eye(6):
        small = se3.exp(1e-6 * np.array([direction, -direction]))
        # A body twist moves the estimate from the right, a world twist from the left.
        moved = estimate @ small if form == "left" else small @ estimate
        slopes.append(gain * (cost(moved[0], *args) - cost(moved[1], *args)) / 2e-6)
    metric = np.repeat([observer.length**2, 1.0], 3)
    in_its_frame = descent if form == "left" else se3.adjoint(estimate, descent)
    assert_allclose(-metric * in_its_frame, slopes, rtol=1e-6, atol=1e-8)


@both_forms
def test_the_damping_term_is_the_mean_error_as_a_translation(form):
    pose, estimate, seen = random_pose(), random_pose(), some(1, 2, 5)
    args = (estimate, LANDMARKS, measured(pose), seen)
    term = Observer(form, damping=3.0).correction(*args) - Observer(form, damping=0.0).correction(*args)
    mean_error = (measured(estimate) - measured(pose))[seen].mean(axis=0)
    assert_allclose(term, np.concatenate([np.zeros(3), 3.0 * mean_error]), atol=1e-12)


@both_forms
def test_without_landmarks_the_estimate_moves_as_the_camera_does(form):
    poses = moving(30, TWIST)
    start = random_pose()
    estimates = Observer(form).estimates(recording(poses, np.zeros((30, 12), dtype=bool)), start[None])[0]
    assert_allclose(se3.inverse(start) @ estimates, se3.inverse(poses[0]) @ poses, atol=1e-9)
    assert_array_equal(Observer(form).correction(start, LANDMARKS, measured(poses[0]), some()), np.zeros(6))


@both_forms
def test_the_pose_is_found_from_random_initial_attitudes(form):
    poses = moving(1000, TWIST)
    seen = RNG.random((1000, 12)) < 0.4
    for angle in (0.5, 1.5, 2.5):
        errors = Observer(form).errors(recording(poses, seen), random_pose(angle)[None])
        assert errors.frobenius[0, -1] < 1e-10
        assert errors.position[0, -1] < 1e-5
        assert errors.attitude[0, -1] < 1e-5


@both_forms
@pytest.mark.parametrize(
    ("landmarks", "rank"),
    [
        ([[1.0, 2.0, 3.0]], 3),
        ([[1.0, 2.0, 3.0], [2.0, 1.0, 3.0]], 5),
        ([[1.0, 2.0, 3.0], [2.0, 3.0, 4.0], [4.0, 5.0, 6.0]], 5),
        ([[1.0, 2.0, 3.0], [2.0, 1.0, 3.0], [1.0, 1.0, 2.0]], 6),
    ],
    ids=["one", "two", "three in line", "three"],
)
def test_the_directions_that_landmarks_correct(form, landmarks, rank):
    landmarks, pose, seen = np.array(landmarks), random_pose(), np.ones(len(landmarks), dtype=bool)
    args = (landmarks, measured(pose, landmarks), seen)
    moved = pose @ se3.exp(1e-6 * np.vstack([np.eye(6), -np.eye(6)]))
    responses = np.array([Observer(form).correction(estimate, *args) for estimate in moved])
    linear = (responses[:6] - responses[6:]) / 2e-6
    assert np.linalg.matrix_rank(linear, tol=1e-6) == rank


@both_forms
@pytest.mark.parametrize(("product", "grows"), [(1.9, False), (2.1, True)])
def test_one_landmark_is_stable_up_to_a_step_times_gain_of_two(form, product, grows):
    pose = random_pose()
    path = corrected(Observer(form, 10.0, 0.0), pose @ se3.exp(np.full(6, 1e-4)), pose, some(0), 40, step=product / 10)
    f = costs(path, pose, some(0))
    assert (f[-1] > f[0]) == grows


@both_forms
def test_too_long_a_time_between_frames_is_refused(form):
    poses = moving(3, np.zeros(6))
    with pytest.raises(InputError, match=r"^gain \+ damping = 50 1/s must stay below 25 1/s"):
        Observer(form, 30.0, 20.0).errors(recording(poses, np.ones((3, 12), dtype=bool)), poses[:1])


def test_the_error_of_the_right_invariant_form_does_not_depend_on_the_motion():
    paths = [moving(100, twist) for twist in (TWIST, 0.0 * TWIST)]
    start_error, seen = random_pose(), np.ones((100, 12), dtype=bool)
    ends = {}
    for form in FORMS:
        errors = []
        for poses in paths:
            estimates = Observer(form).estimates(recording(poses, seen), (start_error @ poses[0])[None])[0]
            errors.append(estimates[20] @ se3.inverse(poses[20]))
        ends[form] = np.abs(errors[0] - errors[1]).max()
    assert ends["right"] < 1e-9
    assert ends["left"] > 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"form": "middle"}, "^form must be one of right, left, got 'middle'"),
        ({"gain": 0.0}, "^gain must be greater than 0"),
        ({"damping": -1.0}, "^damping must be at least 0"),
        ({"length": 0.0}, "^length must be greater than 0"),
    ],
)
def test_a_bad_observer_is_refused(change, message):
    with pytest.raises(InputError, match=message):
        Observer(**change)
