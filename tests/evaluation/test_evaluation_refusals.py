"""Bad settings of studies get one sentence."""

from support.refusals import refusals

test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__)
