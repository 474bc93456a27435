"""Where classes and functions lay in earlier versions: what these wrote still names them."""

# Modules that configurations name, longest first where one begins another.
MODULES = {
    "lmd.camera": "lmd.geometry.camera",
    "lmd.camera_calibration": "lmd.formats.calibrations",
    "lmd.deployment": "lmd.scene.deployment_sources",
    "lmd.localisation.trajectory": "lmd.estimation.flights",
    "lmd.localisation": "lmd.estimation",
    "lmd.mounting": "lmd.evaluation.mounting",
    "lmd.pdf": "lmd.scene.pdf",
    "lmd.recorded_poses": "lmd.scene.recorded_poses",
    "lmd.sight.fiducial": "lmd.sight.models.fiducial",
    "lmd.sight.paper": "lmd.sight.models.paper",
    "lmd.tag": "lmd.scene.tag",
}


def renamed(target: str) -> str:
    """The dotted name that a class or a function has now, the same where it has not moved.

    >>> renamed("lmd.tag.Tag")
    'lmd.scene.tag.Tag'
    """
    for before, now in MODULES.items():
        if target.startswith(f"{before}."):
            return now + target.removeprefix(before)
    return target
