"""Bad input of every command: one sentence with the key or the file, exit code 1, and no files."""

import shlex
from pathlib import Path

import pytest
from support import walks
from support.processes import SMALL, refused

from lmd.geometry.camera import Camera

pytestmark = pytest.mark.slow
# Studies of `evaluate`, and `optimise` with cameras.
ALIASES = {
    name: ("evaluate", f"studies=[{name}]")
    for name in ("bound", "accuracy", "uncertainty", "detect", "observe", "acceptance")
}
ALIASES["cameras"] = ("optimise", "varies=cameras")
HEADER = "id,x,y,z,nx,ny,nz\n"
FILES = {
    "two.csv": HEADER + "0,0,1,1,1,0,0\n1,0,2,1,1,0,0\n",
    "outside.csv": HEADER + "0,0,1,1,1,0,0\n1,0,9,1,1,0,0\n",
    "wide.csv": HEADER + "0,0,2,3,1,0,0\n1,0,3,3,1,0,0\n2,7.5,2,3,-1,0,0\n",
    "less.csv": HEADER + "0,0,2,3,1,0,0\n1,0,3,3,1,0,0\n",
    "half.csv": "yaw,pitch,weight\n0,0,0.5\n",
    "negative.csv": "yaw,pitch,weight\n0,0,-1\n0,1,2\n",
    "tilt.csv": "yaw,tilt,weight\n0,0,1\n",
    "map.csv": HEADER + "3,0,2,3,1,0,0\n",
    "seen.csv": "time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,3,10,20,30,20,30,40,10,40\n",
    "others.csv": "time,id,x0,y0,x1,y1,x2,y2,x3,y3\n0,7,10,20,30,20,30,40,10,40\n",
    "taken": "",
}
CAMERA = "pixel_width=0.0116 pixel_height=0.0116 principal_point=[400,300] image_width=800 image_height=600"
FRAMES = " ".join(["room.spacing=3", *(f"camera.{each}" for each in CAMERA.split()), "tag.edge=0.3"])
SEARCHES = "room.spacing=1.5 objective.n=1 objective.thold_p=0.3 budget.evaluations=20 seeds=2"
# Overrides of all cases of a command, in place of `SMALL`.
SETTINGS = {
    "bound": "room.spacing=2.0 pdf.divisions=6 bound.spacing=1.0 bound.iterations=40",
    "calibrate_detector": f"{FRAMES} frames=10",
    "detect": f"{FRAMES} frames=24 pictures=1",
    "observe": "room.spacing=3 seeds=2 trajectory.duration=4 trajectory.pace.frame_rate=10",
    "uncertainty": "experiment=lab",
    "estimate_pdf": "seed=0",
    "compare": "seed=0",
    "cameras": "room.spacing=1.5 deployment=uniform deployment.count=12 pdf=yaw pdf.divisions=3",
    "view": "room.spacing=1.5 deployment.path=wide.csv tag.edge=0.15",
    "survey": "photographs=photos camera.path=camera.yaml tag.edge=0.25 workers=1",
    "localise": "map=map.csv detections=seen.csv camera.path=camera.yaml tag.edge=0.25",
    "tradeoff": SEARCHES,
}
FILE, MEASURED = "deployment=file deployment.path=", "deployment=file deployment.path=wide.csv tag.edge=0.2 "
PDF, SIZES = "pdf=samples pdf.path=", "tag.edges=[0.1,0.2]"
BOTH, LITTLE = "deployments=[uniform,random]", '"body.boxes=[{low: [-0.1, -0.1, 0], high: [0.1, 0.1, 0.1]}]"'
TAGS, MANY = "deployment.path=wide.csv tag.edge=0.15", "would take"
CASES = [
    ("evaluate", f"{FILE}outside.csv", "outside.csv: landmark 1 at (0, 9, 1) lies outside the room"),
    ("evaluate", f"{FILE}none.csv", "deployment.path: there is no file 'none.csv'"),
    ("evaluate", f"{FILE}null", "deployment.path is missing"),
    ("evaluate", f"{FILE}two.csv deployment.count=3", "deployment.count = 3, but two.csv has 2 landmarks"),
    ("evaluate", f"{FILE}5", "deployment.path must be the path of a file or a folder, got 5"),
    ("evaluate", "room.size=[1,2]", "room.size must be a list of 3 numbers, got [1, 2]."),
    ("evaluate", "room.spacing=1e-3", "room.spacing = 0.001 makes 9.45e+10 positions, which would take"),
    ("evaluate", "camera.image_width=1640.5", "camera.image_width must be a whole number, got 1640.5."),
    ("evaluate", "validate=foo", "validate must be true or false, got 'foo'."),
    ("evaluate", "tag.edge=100", "tag.edge is too large: surface x_min is 5 m wide"),
    ("evaluate", "room.relevance.path=none.csv", "room.relevance.path: there is no file 'none.csv'."),
    ("evaluate", "room.relevance.background=0", "room.relevance.background gives every position the weight 0."),
    ("evaluate", "pdf=recorded", "pdf=recorded needs poses=recorded."),
    ("evaluate", "encoding.kind=tree", "encoding.kind must be one of wall, paper, got 'tree'."),
    ("evaluate", "\"visibility.crowd={number: 3, weight: 80}\"", "visibility.crowd key must be one of number, "),
    ("evaluate", "visibility=fiducial", "tag must have an edge"),
    ("evaluate", "pdf.roll=[[0,0.5]]", "pdf.roll: the probabilities must sum to 1"),
    ("evaluate", "\"camera.rig=[{yaw: 0, jaw: 1}]\"", "camera.rig[0] has an unknown key 'jaw'"),
    ("evaluate", "camera.rig=2", "camera.rig must be a list of cameras, got 2"),
    ("evaluate", "tag.edge=0.1 tag.edges=[0.06,0.2] deployment.count=[4]", "deployment.count = [4] must have one"),
    ("evaluate", "tag.edge=0.1 tag.edges=[0.06,0.2] tag.paper=0.001", "tag.paper = 0.001 m2 is too little"),
    ("evaluate", "deployment.count=+5", "deployment.count = +5 needs deployment.fixed"),
    ("evaluate", f"{PDF}half.csv", "half.csv: the weights must sum to 1, they sum to 0.5"),
    ("evaluate", f"{PDF}negative.csv", "negative.csv has a negative weight, -1"),
    ("evaluate", f"{PDF}tilt.csv", "tilt.csv has an unknown column 'tilt'"),
    ("evaluate", f"{MEASURED} deployment.mounting_error=-1", "deployment.mounting_error.position must be at least 0"),
    ("evaluate", f"{MEASURED} deployment.mounting_error=much", "deployment.mounting_error.position must be a number"),
    ("evaluate", f"{MEASURED} deployment.measured=none.csv", "deployment.measured: there is no file 'none.csv'."),
    ("evaluate", f"{MEASURED} deployment.measured=less.csv", "deployment.measured: less.csv lacks the landmark 2 that"),
    ("evaluate", "studies=[]", "studies must name at least one option of conf/studies"),
    ("evaluate", f"studies=[uncertainty] {BOTH}", "studies=[uncertainty] needs a single deployment"),
    ("evaluate", "suite=tiny_mean room=lab", "suite=tiny_mean sets room.spacing itself: leave room.spacing out"),
    ("evaluate", "suite=nowhere", "nowhere"),
    ("evaluate", "room.keepout=[]", "room.keepout is not a known setting"),
    ("optimise", "optimiser.populaton=3 optimiser=ega", "optimiser.populaton is not a known setting; did you"),
    ("optimise", "varies=rooms", "varies must be one of tags, cameras, got 'rooms'"),
    ("optimise", "experiment=frc_field deployment=random", "deployment.path is not a known setting"),
    ("optimise", "deployment.count=1000000000000", f"deployment.count = 1000000000000 landmarks {MANY}"),
    ("optimise", "budget.evaluations=null", "budget.evaluations or seconds must be given"),
    ("optimise", "export=[wpilib]", "tag.edge must be given, in metres"),
    ("compare", "optimisers=[]", "optimisers must list at least one name, got []"),
    ("compare", "suite=tiny_meen", "suite must be one of"),
    ("compare", "suite=small room=lab", "suite = small sets room itself: leave room out"),
    ("compare", "suite=localised_against_tags", "suite: localised_against_tags has several objectives"),
    ("compare", "suite=tiny_mean suite_budgets=[4]", "suite_budgets must be one of 1, 2, 3, got '4'"),
    ("compare", "kept=5", "kept must be the path"),
    ("bound", "bound.spacing=1e-6", f"bound.spacing = 1e-06 makes 3e+13 poses, which {MANY}"),
    ("bound", "deployment.count=1", "objective.n = 2 exceeds the number of landmarks, 1"),
    ("accuracy", "deployment=file deployment.path=wide.csv tag.edge=1.0", "landmarks 0 and 1 on x_min overlap"),
    ("observe", "seeds=1e12", f"seeds = 1000000000000 runs {MANY}"),
    ("observe", "deployments=[nowhere]", "deployments: 'nowhere' is refused: "),
    ("observe", "deployments=[]", "deployments must list at least one option of conf/deployment"),
    ("observe", "deployments=[uniform,uniform]", "deployments has 'uniform' twice: give them names"),
    ("observe", "\"deployments=['a/b: uniform']\"", "deployments: the name 'a/b' must be of letters"),
    ("observe", "\"deployments=['22 tags: file']\"", "deployments: '22 tags: file' is refused: "),
    ("observe", "deployments=[uniform] deployment.path=a.csv", "deployment.path=a.csv belongs to none of the"),
    ("observe", "deployment=file", "deployment.path is missing"),
    ("observe", "estimator=[]", "estimator must name at least one estimator"),
    ("observe", "estimator.observer.gain=100", "estimator.observer.gain + damping = 101 1/s must stay below 20 1/s"),
    ("observe", "sensor=rendered tag.edge=null", "sensor.tag.edge must be given, in metres, as a detector"),
    ("observe", "sensor=noisy tag.edge=0.1 sensor.reader=eyes", "sensor.reader must be one of aruco"),
    ("observe", "all_visible=true", "all_visible must be false if measurements are not exact"),
    ("detect", "frames=1e12", f"frames = 1000000000000 frames of 90 landmarks {MANY}"),
    ("detect", "tag.edge=null", "tag.edge must be given, in metres, as a detector cannot read a point: measure the"),
    ("detect", "tag.family=16h5", "tag.family 16h5 has 30 different tags, too few for 90."),
    ("detect", "tag.family=36h12", "tag.family must be one of 36h11"),
    ("detect", "detectors=[]", "detectors must name at least one detector."),
    ("detect", "detectors.aruco.preset=best", "detectors.aruco.preset must be one of default, fine, got 'best'"),
    ("detect", "camera.distortion=[-3,0,0,0]", "camera.distortion must keep the image radius increasing"),
    ("calibrate_detector", "+views.sampling.pitch=[3,2]", "views.sampling.pitch must go from the lower to the higher"),
    ("uncertainty", "deployment=uniform uncertainty.corners=mine", "uncertainty.corners must be one of auto, objec"),
    ("uncertainty", "deployment=uniform uncertainty.views=10", "uncertainty.views: only "),
    ("uncertainty", "deployment=uniform visibility=paper tag.edge=null", "tag.edge must be given, in metres"),
    ("uncertainty", "deployment=uniform visibility.crowd=2", "uncertainty does not work with visibility.crowd"),
    ("acceptance", f"{TAGS} acceptance.measured=none.csv", "acceptance.measured: there is no file 'none.csv'"),
    ("acceptance", f"{TAGS} acceptance=null", "acceptance must be a mapping of settings"),
    ("acceptance", f"{TAGS} acceptance.mean=1e-9", "acceptance.mean = 1e-09 m is below the least bound of"),
    ("view", "export=[nosuch]", "export must be one of ros2_tf, "),
    ("view", "visibility.crowd=2", "view does not work with visibility.crowd"),
    ("cameras", f"visibility.crowd=2 {LITTLE}", "optimise varies=cameras does not work with visibility.crowd"),
    ("cameras", "cameras.pitch=[1]", "cameras.pitch must be a list of 2 numbers"),
    ("cameras", "cameras.lenses=[none.yaml]", "cameras.lenses[0].path: there is no file 'none.yaml'"),
    ("cameras", "\"body.boxes=[{low: [0, 0, 0], high: [9, 1, 1]}]\"", "body.boxes: the body is not inside the room: "),
    ("cameras", "\"camera.rig=[{translation: [0.42, 0, 0.3]}]\"", "cameras.count = 2, but the rig has 1 cameras"),
    ("cameras", f"optimiser=greedy {LITTLE}", "Greedy places landmarks, not cameras"),
    ("tradeoff", "size=true", "size needs a detector: set visibility=fiducial"),
    ("tradeoff", "\"size={distance: [0]}\" visibility=fiducial tag.edge=0.1", "size.distance[0] must be greater"),
    ("estimate_pdf", "seed=0", "recording.path is missing"),
    ("tradeoff", "counts=20", "counts must be a list of numbers, got 20."),
    ("tradeoff", "counts=[0]", "counts must be at least 1, got 0."),
    ("tradeoff", "edges=[a]", "edges must be a number, got 'a'."),
    ("tradeoff", SIZES, "tag.edges is for mixtures of sizes: give edges=[...] for single sizes"),
    ("tradeoff", "figure=cost", "figure must be one of "),
    ("tradeoff", "edges=[2]", "counts = 20 tags with papers of 2.5 m are too many"),
    ("export", "tag.edge=0.15", "deployment.path is missing: a CSV of landmarks or a tag map is needed."),
    ("export", "deployment.path=wide.csv", "tag.edge must be given, in metres"),
    ("export", f"{TAGS} formats=[]", "formats must list at least one format (docs/mounting.md), got []."),
    ("export", f"{TAGS} formats=[nosuch]", "formats must be one of ros2_tf, "),
    ("export", f"{TAGS} tag.family=4x4_50 formats=[csv,wpilib]", "formats has wpilib, which supports families "),
    ("export", f"{TAGS} paper_size=a5", "paper_size must be one of a4, a3, letter, got"),
    ("survey", "photographs=null", "either photographs (a folder, a video or a bag) or detections (a CSV file)"),
    ("survey", "photographs=nowhere", "photographs: there is no folder, video or bag 'nowhere'"),
    ("survey", "photographs=two.csv", "photographs: 'two.csv' cannot be read as a video: it is a text"),
    ("survey", "photographs=cut.mp4", "photographs: 'cut.mp4' cannot be read as a video: OpenCV cannot open it"),
    ("survey", "tag.family=4x4_100", "family"),
    ("survey", "export=[wpilib]", "export needs a room: give run=DIR"),
    ("survey", "detectors=[apriltag,aruco]", "detectors must name one detector, got ['apriltag', 'aruco']"),
    ("survey", "audit=true", "audit needs a visibility model of tags: visibility=fiducial"),
    ("survey", "images=two.csv", "images = 'two.csv' goes with detections, not with photographs"),
    ("survey", "deployment=random", "deployment must be a file"),
    ("survey", "camera.path=two.csv", "two.csv"),
    ("localise", "map=null", "a tag map (map=FILE) or a run (run=DIR) must be given"),
    ("localise", "map=nowhere.csv", "map: there is no file 'nowhere.csv'"),
    ("localise", "map=photos", "map: there is no file 'photos/landmarks.csv'"),
    ("localise", "deployment.path=map.csv", "map and deployment.path both name a map"),
    ("localise", "tag.edge=null", "tag.edge must be given, in metres: the map has no edge of tag 3"),
    ("localise", "photographs=photos", "either photographs (a folder, a video or a bag) or detections (a CSV file)"),
    ("localise", "detections=others.csv", "detections has no tag of the map, only tags such as 7"),
    ("localise", "localise.motion=2", "localise.motion must be true or false, got 2"),
    ("localise", "localise.odometry={file:a.csv}", "localise.odometry key must be one of path, frame"),
    ("survey", "\"camera.rig=[{camera: camera.yaml}, {camera: camera.yaml}]\"", "2 cameras, but 'photos' has 0"),
]  # fmt: skip


@pytest.mark.parametrize(("command", "overrides", "message"), CASES)
def test_bad_input_gets_one_sentence_and_leaves_nothing(command, overrides, message, tmp_path):
    for name, text in FILES.items():
        Path(tmp_path, name).write_text(text)
    if command in ("survey", "localise"):
        (tmp_path / "photos").mkdir()
        (tmp_path / "cut.mp4").write_bytes(b"\0\0\0\x18ftypisom\0\0\0\0isom")
        walks.calibration(tmp_path / "camera.yaml", Camera(2.2, 0.0075, 0.0075, (320.0, 240.0), 640, 480, 0.0))
    settings = shlex.split(SETTINGS[command]) if command in SETTINGS else SMALL
    name, *more = ALIASES.get(command, (command,))
    given = (*more, *shlex.split(overrides), "tracking=none", "hydra.run.dir=run")
    refused(name, *given, message=message, cwd=tmp_path, settings=settings)
