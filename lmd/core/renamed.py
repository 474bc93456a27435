"""Where classes and functions lay in earlier versions: what these wrote still names them."""

# Modules that configurations name, longest first where one begins another.
MODULES = {
    "lmd.camera": "lmd.scene.camera",
    "lmd.camera_calibration": "lmd.scene.camera_calibration",
    "lmd.deployment": "lmd.scene.deployment",
    "lmd.localisation.trajectory": "lmd.estimation.flights",
    "lmd.localisation": "lmd.estimation",
    "lmd.mounting": "lmd.evaluation.mounting",
    "lmd.pdf": "lmd.scene.pdf",
    "lmd.recorded_poses": "lmd.scene.recorded_poses",
    "lmd.sight.fiducial": "lmd.sight.models.fiducial",
    "lmd.sight.paper": "lmd.sight.models.paper",
    "lmd.tag": "lmd.scene.tag",
}
# Classes that have left the module their others are in.
CLASSES = {
    "lmd.deployment.FileDeployment": "lmd.scene.deployment_sources.FileDeployment",
    "lmd.deployment.GivenDeployment": "lmd.scene.deployment_sources.GivenDeployment",
    "lmd.deployment.RandomDeployment": "lmd.scene.deployment_sources.RandomDeployment",
    "lmd.deployment.UniformDeployment": "lmd.scene.deployment_sources.UniformDeployment",
    "lmd.scene.deployment.FileDeployment": "lmd.scene.deployment_sources.FileDeployment",
    "lmd.scene.deployment.GivenDeployment": "lmd.scene.deployment_sources.GivenDeployment",
    "lmd.scene.deployment.RandomDeployment": "lmd.scene.deployment_sources.RandomDeployment",
    "lmd.scene.deployment.UniformDeployment": "lmd.scene.deployment_sources.UniformDeployment",
}


def renamed(target: str) -> str:
    """The dotted name that a class or a function has now, the same where it has not moved.

    >>> renamed("lmd.tag.Tag")
    'lmd.scene.tag.Tag'
    """
    if target in CLASSES:
        return CLASSES[target]
    for before, now in MODULES.items():
        if target.startswith(f"{before}."):
            return now + target.removeprefix(before)
    return target
