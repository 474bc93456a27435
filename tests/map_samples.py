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
}
TEXTS = {
    "launch": 'TAGS = [\n    ("tag36h11:7", 2.0, 0.0, 1.2, 0.0, 0.0, 0.0, 1.0),\n]\n',
}
