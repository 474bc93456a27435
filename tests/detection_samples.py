"""Small samples of detections by other programs."""

import json

CORNERS = [[10.0, 20.0], [20.0, 20.0], [20.0, 10.0], [10.0, 10.0]]  # counter-clockwise from the bottom left
PHOTON = [
    {
        "metadata": {"captureTimestampMicros": 325917 + frame, "sequenceID": frame},
        "targets": [
            {"fiducialId": 18, "detectedCorners": [{"x": x + frame, "y": y} for x, y in CORNERS]},
            {"fiducialId": -1, "detectedCorners": []},
        ],
    }
    for frame in (0, 1)
]
LIMELIGHT = {"Results": {"Fiducial": [{"fID": 18, "fam": "36H11C", "pts": CORNERS}], "ts": 1325.5, "v": 1}}
VMM = {
    "images": [{"filename": "DSC1.JPG", "id": "0"}],
    "tags": [{"id": "0", "tag_type": "apriltag_36h11", "width": "0.1", "height": "0.1"}],
    "tag_observations": [
        {"image_id": "0", "tag_id": "18", "observations": [[str(number) for number in corner] for corner in CORNERS]}
    ],
}
SAMPLES = {
    "PhotonVision": json.dumps(PHOTON),
    "Limelight": json.dumps(LIMELIGHT),
    "Visual Marker Mapping": json.dumps(VMM),
}
