"""Bad settings of studies get one sentence."""

from support.tables import refusals

test_what_cannot_be_is_refused_in_one_sentence = refusals(__file__)
