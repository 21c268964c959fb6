# SPDX-License-Identifier: Apache-2.0
"""`diagnose --fail-on`: what the exit code says to the script that looks after a machine."""

from __future__ import annotations

from types import SimpleNamespace

import pandas as pd
import pytest

from waferbot_twin.cli.diagnose import exit_code
from waferbot_twin.cli.main import main

CALM = {'unexplained': 0, 'causes': 0, 'gains': [3.0, -0.5]}
ALL = ('unexplained', 'cause', 'loss')


def result(unexplained, causes, gains):
    """Return what `exit_code` looks at of a diagnosis."""
    return SimpleNamespace(
        unexplained=pd.DataFrame({'channel': ['x_rotate'] * unexplained}),
        causes=pd.DataFrame({'cause': ['backlash:y_rotate'] * causes}),
        gains=pd.DataFrame({'improvement_percent': gains}),
    )


@pytest.mark.parametrize(
    ('found', 'asked', 'code'),
    [
        ({}, ALL, 0),
        ({'gains': []}, ALL, 0),
        ({'unexplained': 1}, ('unexplained',), 3),
        ({'causes': 2}, ('cause',), 4),
        ({'gains': [3.0, -1.5]}, ('loss',), 5),
        ({'unexplained': 1, 'causes': 1, 'gains': [-2.0]}, ALL, 3),
        ({'unexplained': 1, 'causes': 1, 'gains': [-2.0]}, ('loss', 'cause'), 4),
        ({'unexplained': 1, 'causes': 1, 'gains': [-2.0]}, (), 0),
        ({'unexplained': 1}, ('cause', 'loss'), 0),
    ],
)
def test_the_first_of_what_was_asked_for_and_is_so_gives_the_code(found, asked, code) -> None:
    assert exit_code(result(**{**CALM, **found}), asked) == code


def test_a_condition_that_there_is_not_is_a_wrong_command_line(capsys) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['diagnose', 'log', '--out', 'report', '--fail-on', 'everything'])
    assert ended.value.code == 2
    assert 'unexplained' in capsys.readouterr().err
