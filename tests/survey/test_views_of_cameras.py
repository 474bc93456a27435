"""What a survey tells of the detector; some 5 seconds."""

import numpy as np
import pytest
import walks

from lmd.core.checks import InputError
from lmd.core.tables import write_table
from lmd.detection.calibration import Calibration
from lmd.detection.fit import fit, intervals
from lmd.detection.surveyed import FILE, SurveyedViews
from lmd.render.imaging import Imaging
from lmd.scene.camera import Camera
from lmd.scene.tag import Tag
from lmd.survey.survey import Known, survey
from lmd.survey.views import view_columns

CAMERA, TAG, SIGMA, COUNT = Camera(2.2, 0.0055, 0.0055, (320.0, 240.0), 640, 480, 0.0), Tag(0.16), 0.1, 24
LEAST = walks.SMALLEST / TAG.modules  # pixels a module, of what these detectors find


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The views of a walk through a long room, in which many tags are too far away."""
    rng, folder = np.random.default_rng(2), tmp_path_factory.mktemp("surveyed")
    true = np.stack([walks.on_wall(k % 4, (k // 4 + 0.5) / 6, 1.2, width=9.0, depth=4.0) for k in range(COUNT)])
    frames = walks.walk(80, rng, width=9.0)
    detected = walks.photographed(true, frames, rng, SIGMA, CAMERA, edges=TAG.size)
    found = survey(detected, [CAMERA], TAG, walks.constant_errors(SIGMA), Known())
    write_table(folder / FILE, view_columns(found, CAMERA, TAG, None))
    return folder


def test_limits_fitted_to_a_survey_are_those_of_its_detector(folder):
    source, rng = SurveyedViews(str(folder)), np.random.default_rng(0)
    views = source.views(CAMERA, TAG, None, Imaging(), rng)
    assert 100 < views.seen.sum() < len(views)
    fitted, spans = fit(views, rng, 0.0), intervals(views, rng, 0.0)
    least = np.hypot(fitted.limits.pitch, fitted.limits.blur * views.sigma[0])
    by_edge = fitted.limits.edge / TAG.modules
    assert max(least, by_edge) == pytest.approx(LEAST, abs=0.3)
    assert fitted.accuracy > 0.9
    assert all(low <= high for low, high in spans.values())
    text = Calibration(views, fitted, {}, source.photographs, spans).preset("apriltag", "36h11", "survey")
    assert f"# Measured on {source.photographs} photographs." in text
    assert "# 90 % intervals: pitch " in text


def test_a_folder_that_is_no_survey_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"^folder: .* is no survey of one camera: it holds no in_view\.csv\.$"):
        SurveyedViews(str(tmp_path))
