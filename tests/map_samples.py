"""Small samples of tag maps that mapping programs, simulators and ROS 2 keep; `format_samples` lists them."""

TRANSFORM = [1, 0, 0, 2], [0, 0, -1, 0], [0, 1, 0, 1.2], [0, 0, 0, 1]  # upright, looks along -y
HALF = 0.7071067811865476
KEYED = {
    "ros2 bundle": {
        "tag_bundles": {
            "bundle_names": ["wall"],
            "wall": {"ids": [1], "1": {"size": 0.1, "transform": [2, 0, 1.2, HALF, HALF, 0, 0]}},
        }
    },
    "ros2 layout": {
        "tag_bundles": {"bundle_names": ["wall"], "wall": {"layout": {"ids": [1], "1": {"size": 0.1, "x": 2.0}}}}
    },
    "visual marker mapping": {
        "reconstructed_tags": [
            {
                "id": "7",
                "type": "apriltag_36h11",
                "width": "0.1",
                "height": "0.1",
                "rotation": [str(HALF), str(HALF), "0.0", "0.0"],
                "translation": ["2.0", "0.0", "1.2"],
            }
        ],
        "reconstructed_cameras": [],
    },
    "pytagmapper": {
        "tag_side_lengths": {"default": 0.1, "8": 0.2},
        "tag_locations": {"7": TRANSFORM, "8": TRANSFORM},
        "map_type": "3d",
    },
    "pytagmapper 2.5d": {
        "tag_side_lengths": {"default": 0.1},
        "tag_locations": {"7": [1, 2, 0.5, 0.25]},
        "map_type": "2.5d",
    },
    "zed": {
        "general": {"marker_count": 1, "marker_size": 0.16},
        "marker_000": {"aruco_id": 7, "position": [2, 0, 1.2], "orientation": [0, 0, -1.57]},
        "marker_001": {"aruco_id": 8, "position": [2, 0, 1.2], "orientation": [0, 0, -1.57]},
    },
    "tags by number": {"tags": {"7": {"xyz": [2, 0, 1.2], "quaternion_wxyz": [HALF, HALF, 0, 0]}}},
    "landmarks": {"landmarks": [{"id": 7, "position": [2, 0, 1.2], "orientation": [1.57, 0, 0]}]},
}
CORNERS = (
    (2, 0, 1),
    (2.2, 0, 1),
    (2.2, 0, 1.2),
    (2, 0, 1.2),
)  # from the lower left one on, of a tag that looks along -y
NODES = "".join(
    f'<node id="{k}"><tag k="local_x" v="{x}"/><tag k="local_y" v="{y}"/><tag k="ele" v="{z}"/></node>'
    for k, (x, y, z) in enumerate(CORNERS)
)
LANELET = (
    f'<?xml version="1.0"?><osm version="0.6">{NODES}<way id="5"><nd ref="0"/><nd ref="1"/><nd ref="2"/><nd ref="3"/>'
    '<tag k="type" v="pose_marker"/><tag k="subtype" v="apriltag_36h11"/><tag k="marker_id" v="7"/></way></osm>'
)


def world(inside):
    """A world of Gazebo with these elements in it."""
    return f'<?xml version="1.0"?><sdf version="1.6"><world name="w">{inside}</world></sdf>'


def plate(name, picture, size, pose="0 0 0 0 0 0", around=""):
    """A model with a plate that shows a picture."""
    shape = f"<geometry><box><size>{size}</size></box></geometry>"
    seen = f"<material><script><name>{picture}</name></script></material>"
    return (
        f'<model name="{name}"><pose>{pose}</pose>{around}<link name="l"><visual name="v">{shape}{seen}</visual>'
        "</link></model>"
    )


TEXTS = {
    "lanelet": LANELET,
    "gazebo": world(plate("tag", "Apriltag36_11_00007", "0.3 0.3 0.01", "1 2 0 0 0 0")),
    "launch": 'TAGS = [\n    ("tag36h11:7", 2.0, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0),\n]\n',
    "g2o": "VERTEX_SE3:QUAT 9 1 0 1 0 0 0 1\nVERTEX_SE3:QUAT 2 0 0 0 0 0 0 1\nEDGE_SE3 2 9 1 0 1 0 0 0 1 1\n",
}
