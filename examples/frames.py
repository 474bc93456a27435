"""Tag maps as a JSON with the frame of each tag."""

import json
from pathlib import Path

import numpy as np

from lmd.core.checks import vector
from lmd.formats.placed_tag import Found, PlacedTag, mappings, number_of, transform_of
from lmd.formats.registry import Format, Writer
from lmd.formats.tag_map import TagMap
from lmd.formats.trees import File


def write_frames(path: Path, tags: TagMap) -> None:
    """Write `tags.frames.json`: the frame of a tag (x right, y up, z out) and its position, metres, `(3, 4)` each."""
    poses = np.concatenate([tags.turns.as_matrix(), tags.positions[:, :, None]], axis=2).tolist()
    frames = [{"id": number, "pose": pose} for number, pose in zip(tags.ids, poses, strict=True)]
    path.write_text(json.dumps({"frames": frames}), encoding="utf-8")


def read_frames(file: File) -> Found:
    """Read what `write_frames` writes."""
    tags = []
    for tag in mappings("frames", file.data["frames"]):
        number, rows = number_of(tag["id"]), [vector("pose", row, 4) for row in tag["pose"]]
        pose = transform_of([*np.ravel(rows).tolist(), 0.0, 0.0, 0.0, 1.0], "pose", f"tag {number}: ")
        tags.append(PlacedTag(number, pose[:3, 3], pose[:3, :3]))
    return Found(tags)


WRITER = Writer("tags.frames.json", write_frames)
FORMATS = [Format("tag map", "frames", lambda file: "frames" in file.data, read_frames, writer=WRITER)]
