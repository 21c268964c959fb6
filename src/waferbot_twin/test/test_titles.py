# SPDX-License-Identifier: Apache-2.0
"""Axes are said by their titles; names of logs stay."""

from __future__ import annotations

import pytest

from waferbot_lockstep.contract import USUAL_TITLES
from waferbot_twin.titles import with_titles


@pytest.mark.parametrize(
    ('text', 'said'),
    [
        ('ddp: y_rotate.force against its position', 'ddp: Y-Rotate force against its position'),
        ('log: the model has no controller of y_linear, so', None),
        (
            'step_y_rotate.csv: both encoders of y_rotate',
            'step_y_rotate.csv: both encoders of Y-Rotate',
        ),
    ],
)
def test_axes_are_said_by_their_titles_and_names_of_logs_stay(text, said):
    assert with_titles(text, USUAL_TITLES) == (said or text.replace('y_linear', 'Y-Linear'))


def test_a_title_that_names_another_axis_is_not_said_anew():
    titles = {**USUAL_TITLES, 'y_linear': r'lift of x_rotate \1'}
    said = with_titles('y_linear.force and x_rotate', titles)
    assert said == r'lift of x_rotate \1 force and X-Rotate'


def test_what_is_said_already_is_not_said_anew():
    """A title with the name of its own axis in it, and axes that are called by their names."""
    titles = {'arm': 'upper arm (left)', 'elbow': 'elbow'}
    said = with_titles('elbow.force: arm moves as well', titles)
    assert said == 'elbow force: upper arm (left) moves as well'
    assert with_titles(said, titles) == said
