"""Bad settings of detectors, views and images get one sentence."""

from support.tables import refusals

from lmd.detection.video import Video

test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__, **{"a video": lambda path: Video(path, 5)})
