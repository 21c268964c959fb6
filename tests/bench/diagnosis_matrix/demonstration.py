# SPDX-License-Identifier: Apache-2.0
"""
The demonstration as a case: the logs of the machine as built, diagnosed against the rigid model.

By the functions of `waferbot demo`, without ROS. Nobody hid anything there: what differs is what the two
models have different (`differences`), and the values are those that make one of the other
(`deviations.equivalents`).
"""

from __future__ import annotations

import json
import re
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from diagnosis_matrix import scoring
from diagnosis_matrix.deviations import equivalents
from diagnosis_matrix.differences import differing, same_names
from waferbot_twin.cli import demo
from waferbot_twin.diagnosis.report import as_dict
from waferbot_twin.effects.variant import Variant
from waferbot_twin.models import load_model
from waferbot_twin.recording.writer import as_json

MODEL = demo.MODEL

LOOKED_FOR = {
    'cables': r'cable_compliance:y_linear',
    'X-Rotate bearing': r'bearing_(moment|radial)_compliance:x_rotate',
    'belt or gearbox': r'(belt|gearbox)_compliance:y_rotate',
    'Y-Rotate friction': r'\w*(friction|damping):y_rotate',
}
"""What the machine is known to have and the rigid model has not, and the names that say so."""

NAMED, NONE = 'all names true', 'no name'
SOME_FALSE = 'a false name'


def run() -> dict[str, Any]:
    """Return the line of results of the demonstration."""
    with tempfile.TemporaryDirectory() as folder:
        demo.make_logs(Path(folder))
        begun_s = time.perf_counter()
        diagnosis = demo.diagnosis_of_logs(Path(folder), lambda what, done, total: None)
        wall_s = time.perf_counter() - begun_s
    nominal, real = (Variant.of(load_model(name)) for name in (demo.MODEL, demo.MACHINE))
    report = json.loads(as_json(as_dict(diagnosis, quick=True)))
    return {
        **score(report, differing(nominal, real), equivalents(nominal, real), same_names(nominal)),
        'runtime_s': wall_s,
    }


def score(
    report: dict[str, Any],
    differs: Sequence[str],
    truth: dict[str, float],
    same: dict[str, str],
) -> dict[str, Any]:
    """
    Return what a report says of what differs: names, what was looked for, values, gains.

    `differs` has every `effect:axis` that is true, `truth` the values that are known, by
    `effect:axis.parameter`.
    """
    # Nothing was hidden, so that nothing can be missed: what must be there is looked for by name.
    hidden = dict.fromkeys(differs, 0.0)
    names = scoring.effects_and_names(report['causes'], hidden, same)['names']
    true = [item['name'] for item in names if item['true']]
    errors = []
    for cause in report['causes']:
        for name, item in cause['parameters'].items():
            path = f'{scoring.name_of(cause)}.{name}'
            if scoring.name_of(cause) in true and path in truth:
                covered = scoring.is_within(truth[path], item['low95'], item['high95'])
                errors.append(
                    {
                        'effect': cause['effect'],
                        'name': name,
                        'kind': 'demo',
                        'truth': truth[path],
                        'found': item['value'],
                        'covered': covered,
                    }
                )
    outcome = NONE if not names else NAMED if len(true) == len(names) else SOME_FALSE
    return {
        'outcome': outcome,
        'hidden': [],
        'verdict': report['verdict'],
        'differs': list(differs),
        'names': names,
        'found': {
            what: any(re.fullmatch(pattern, name) for name in true)
            for what, pattern in LOOKED_FOR.items()
        },
        'demo_errors': errors,
        'corrections': scoring.corrections(report, truth),
        'gains': {
            axis: item['improvement_percent'] for axis, item in report['gain']['axes'].items()
        },
        'reported': [
            {
                'name': scoring.name_of(cause),
                'probability': cause['probability'],
                'group': scoring.others_of(cause),
                'values': {key: item['value'] for key, item in cause['parameters'].items()},
            }
            for cause in report['causes']
        ],
        'unexplained': report['unexplained'],
    }
