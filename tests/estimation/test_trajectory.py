import numpy as np
import pytest
import shapely
from numpy.testing import assert_allclose, assert_array_equal
from support.paper import paper_room, paper_scene
from support.rooms import lab

from lmd.core.checks import InputError
from lmd.estimation.flights import FileTrajectory, Pace, RandomMotion
from lmd.geometry import se3
from lmd.geometry.frames import optical_axis
from lmd.geometry.trajectory import Trajectory
from lmd.scene import pdf
from lmd.space.space import check_inside

SCENE = paper_scene()
PACE = Pace(speed=0.8, turn_rate=1.2, frame_rate=50.0)


def drawn(source, scene=SCENE, seed=0):
    return source.draw(scene, np.random.default_rng(seed))


def twists(trajectory):
    steps = se3.log(se3.inverse(trajectory.poses[:-1]) @ trajectory.poses[1:])
    return steps / np.diff(trajectory.time)[:, None]


@pytest.mark.parametrize("orientations", [pdf.grid_with_ends(), pdf.solid_angle(), pdf.level_flight()])
def test_random_motion_stays_in_the_reachable_area_and_in_its_limits(orientations):
    scene = paper_scene(orientations=orientations)
    trajectory = drawn(RandomMotion(60.0, PACE), scene)
    positions = trajectory.poses[:, :3, 3]
    assert (positions >= scene.room.reachable_low).all()
    assert (positions <= scene.room.reachable_high).all()
    twist = twists(trajectory)
    speed, rate = np.linalg.norm(twist[:, 3:], axis=1), np.linalg.norm(twist[:, :3], axis=1)
    assert speed.max() <= 0.8 * (1 + 1e-3)  # the chord of a twist is a little longer than the straight line
    assert rate.max() <= 1.2 * (1 + 1e-9)
    assert max(speed.max() / 0.8, rate.max() / 1.2) > 0.99


def test_random_motion_is_smooth():
    twist = twists(drawn(RandomMotion(60.0, PACE)))
    assert np.abs(np.diff(twist, axis=0)).max() < 0.2
    finer = twists(drawn(RandomMotion(60.0, Pace(0.8, 1.2, 500.0))))
    assert np.abs(np.diff(finer, axis=0)).max() < 0.02  # the velocity has no jumps


def test_random_motion_is_the_seeds():
    source = RandomMotion(20.0, PACE)
    assert_array_equal(drawn(source).poses, drawn(source).poses)
    assert not np.allclose(drawn(source).poses, drawn(source, seed=1).poses)
    longer = drawn(RandomMotion(40.0, PACE))
    assert_array_equal(longer.poses[: len(drawn(source).poses)], drawn(source).poses)


def test_the_frames_are_as_many_as_duration_and_rate_say():
    trajectory = drawn(RandomMotion(0.3, Pace(1.0, 1.0, 10.0)))
    assert_allclose(trajectory.time, [0.0, 0.1, 0.2, 0.3])


def test_orientations_follow_the_pdf():
    level = drawn(RandomMotion(60.0, PACE), paper_scene(orientations=pdf.level_flight(pitch=0.3)))
    assert_allclose(level.poses[:, 2, 2], np.sin(0.3))
    one_way = pdf.OrientationPdf([0.5], [0.1], [1.0])
    steady = drawn(RandomMotion(10.0, PACE), paper_scene(orientations=one_way))
    assert_allclose(steady.poses[:, :3, 2] - optical_axis(0.5, 0.1), 0.0, atol=1e-12)


def test_waypoints_are_visited_at_rest_and_the_yaw_turns_the_shorter_way():
    points = [[1.0, 1.0, 1.0, 3.0, 0.0], [1.0, 1.0, 1.0, -3.0, 0.5], [2.0, 1.0, 2.0, -3.0, 0.0]]
    trajectory = Pace(1.0, 1.0, 1000.0).through(np.array(points))
    turn = 1.875 * np.hypot(2 * np.pi - 6.0, 0.5)
    assert_allclose(trajectory.time[-1], turn + 1.875 * np.sqrt(2.0), atol=2e-3)
    for point, time in zip(points, [0.0, turn, trajectory.time[-1]], strict=True):
        near = np.abs(trajectory.time - time).argmin()
        assert_allclose(trajectory.poses[near], se3.camera_pose(point[:3], *point[3:]), atol=1e-4)
    at_turn = np.abs(trajectory.time - turn).argmin()
    assert np.abs(twists(trajectory)[[0, at_turn, -1]]).max() < 0.01


ANGLES = "time,x,y,z,yaw,pitch\n0,1,2,3,0.5,0.2\n0.5,1.5,2,3,0.6,-0.2\n"


def test_a_file_gives_its_poses(write):
    trajectory = drawn(FileTrajectory(write(ANGLES)))
    assert_allclose(trajectory.time, [0.0, 0.5])
    assert_allclose(trajectory.poses, se3.camera_pose([[1, 2, 3], [1.5, 2, 3]], [0.5, 0.6], [0.2, -0.2]))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,x,y,z,yaw,pitch\n0,1,1,1,0,0\n", "table.csv: a trajectory must have at least 2 frames, got 1"),
        (ANGLES + "0.4,1,1,1,0,0\n", "csv: line 4: the times of a trajectory must increase, but 0.4 s follows 0.5 s"),
        (
            "time,x,y,z,yaw,pitch\n1311868164.3998,1,1,1,0,0\n1311868164.3997,1,1,1,0,0\n",
            r"csv: line 3: .*, but 1311868164.3997 s follows 1311868164.3998 s",
        ),
        (ANGLES + "1,9,1,1,0,0\n", r"table.csv: the camera at 1 s, \(9, 1, 1\), is outside the room of 7.5 x 5 x 6 m"),
    ],
)
def test_a_bad_file_gets_one_sentence(write, text, message):
    with pytest.raises(InputError, match=message):
        drawn(FileTrajectory(write(text)))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: drawn(FileTrajectory(None)), "^path is missing"),
        (lambda: drawn(FileTrajectory("none.csv")), "path: there is no file 'none.csv'"),
        (lambda: Pace(0.0, 1.0, 1.0), "^speed must be greater than 0"),
        (lambda: RandomMotion(-1.0, PACE), "^duration must be greater than 0"),
    ],
)
def test_bad_settings_get_one_sentence(build, message):
    with pytest.raises(InputError, match=message):
        build()


def test_the_default_room_of_a_trajectory_is_closed():
    on_the_wall = Trajectory(np.array([0.0, 1.0]), se3.camera_pose([[0.0, 1.0, 1.0], [7.5, 5.0, 6.0]], [0, 0], [0, 0]))
    check_inside(on_the_wall, paper_room())


def test_random_flights_go_round_what_stands_in_the_room():
    room = lab(clearance=0.25)
    for seed in range(5):
        positions = drawn(RandomMotion(60.0, PACE), paper_scene(room), seed).poses[:, :3, 3]
        assert room.contains(positions).all()
        assert room.passable(positions[:-1], positions[1:]).all()
        away = shapely.distance(room.plan.ground.boundary, shapely.points(positions[:, :2]))
        assert away.min() >= 0.25 - 1e-5


@pytest.mark.parametrize(("start", "end"), [([1, 1, 1], [2, 2, 1]), ([5, 1, 1], [2, 3.5, 1])])
def test_flights_through_pillars_and_corners_are_refused(start, end):
    scene = paper_scene(lab())
    poses = se3.camera_pose(np.array([start, end], dtype=float), np.zeros(2), np.zeros(2))  # no frame on the way
    with pytest.raises(InputError, match=r"^the camera's straight path from .* passes through an obstacle in the"):
        check_inside(Trajectory(np.array([0.0, 1.0]), poses), scene.room)


def test_a_camera_that_no_straight_way_leads_away_from_is_refused():
    with pytest.raises(InputError, match=r"^none of \d+ straight paths from"):
        drawn(RandomMotion(60.0, PACE), paper_scene(Walled(lab())))


class Walled:
    """A room in which no way is free."""

    def __init__(self, room):
        self._room = room

    def __getattr__(self, name):
        return getattr(self._room, name)

    def passable(self, starts, ends):
        return np.zeros(np.broadcast_shapes(starts.shape, ends.shape)[:-1], dtype=bool)
