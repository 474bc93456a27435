"""Bad files and settings of formats get one sentence."""

from support.tables import refusals

from lmd.formats.calibrations import calibrated_camera, read_calibration
from lmd.formats.tag_maps import read_deployment
from lmd.formats.trajectories import TrajectoryFile

test_what_cannot_be_is_refused_in_one_sentence = refusals(
    __file__,
    **{
        "a map of tags": read_deployment,
        "a calibration": read_calibration,
        "a calibrated camera": calibrated_camera,
        "a trajectory": lambda path, *more, **settings: TrajectoryFile(path, *more, **settings).trajectory,
    },
)
