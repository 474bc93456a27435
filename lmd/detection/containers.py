"""Kinds of video files by their first bytes.

What decodes videos also opens playlists, scripts and descriptions of streams, which name other files and addresses. A
file from a stranger is handed to it only if it is itself a video, and then only to the demuxer of its kind.
"""

import codecs
import re
from contextlib import suppress
from typing import NamedTuple

FIRST = 4096  # bytes that tell the kind
LEAST_PACKETS = 4  # of a transport stream that begin with its sync byte, or all there are


class Container(NamedTuple):
    """A kind of video file.

    Args:
        name: for messages.
        demuxers: what FFmpeg calls those that read it, with commas.
        begins: matches the first bytes of such a file.
    """

    name: str
    demuxers: str
    begins: re.Pattern[bytes]


def _kind(name: str, demuxers: str, begins: bytes) -> Container:
    return Container(name, demuxers, re.compile(begins, re.DOTALL))


CONTAINERS = (
    _kind("MP4 and MOV", "mov", rb".{4}(ftyp|styp|moov|mdat|wide|free|skip|pnot)"),
    _kind("Matroska and WebM", "matroska,webm", rb"\x1a\x45\xdf\xa3"),
    _kind("AVI", "avi", rb"RIFF.{4}AVI[ \x19]"),
    _kind("Ogg", "ogg", rb"OggS\0"),
    _kind("FLV", "flv", rb"FLV\x01"),
    _kind("IVF", "ivf", rb"DKIF\0"),
    _kind("ASF", "asf", rb"\x30\x26\xb2\x75\x8e\x66\xcf\x11"),
    _kind("MXF", "mxf", rb"\x06\x0e\x2b\x34\x02\x05\x01\x01"),
    # Packets of 188 bytes; before each, a camcorder writes a time of 4 bytes; after each, there may be a checksum.
    *(
        _kind("MPEG-TS", "mpegts", rb".{%d}\x47(.{%d}\x47){%d}" % (before, size - 1, LEAST_PACKETS - 1))
        for before, size in ((0, 188), (4, 192), (0, 204))
    ),
    _kind("MPEG-PS", "mpeg", rb"\0\0\x01\xba"),
    _kind("raw MPEG-2", "mpegvideo", rb"\0\0\x01\xb3"),
    _kind("raw MPEG-4", "m4v", rb"\0\0\x01(\xb0|[\x00-\x1f]\0\0\x01[\x20-\x2f])"),
    # Start code, then the kind of the first unit: parameters, a delimiter or information.
    _kind("raw H.264", "h264", rb"\0{2,8}\x01[\x07\x27\x47\x67\x06\x09\x29\x49\x69]"),
    _kind("raw H.265", "hevc", rb"\0{2,8}\x01[\x40\x42\x46\x4e]\x01"),
)
IMAGE = re.compile(rb"\x89PNG|\xff\xd8\xff|BM|II\*\0|MM\0\*|RIFF.{4}WEBP|GIF8", re.DOTALL)


def container_of(head: bytes) -> Container | None:
    """The kind of a video file that begins with `head`; None if it is none that is read."""
    return next((kind for kind in CONTAINERS if kind.begins.match(head)), None)


def refusal(head: bytes) -> str:
    """Why a file that begins with `head` is not read, as the rest of a sentence that begins with its name."""
    read = ", ".join(dict.fromkeys(kind.name for kind in CONTAINERS))
    if IMAGE.match(head):
        return "is one image: a folder of photographs is read, or a video."
    what = "does not begin as a video does" if head else "is empty"
    if head and b"\0" not in head:
        with suppress(UnicodeDecodeError):
            codecs.getincrementaldecoder("utf-8")().decode(head)  # of which the last character may be cut
            what = "is a text, as playlists are, which name other files"
    return f"cannot be read as a video: it {what}; read are {read}."
