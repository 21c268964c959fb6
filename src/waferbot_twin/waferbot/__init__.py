# SPDX-License-Identifier: Apache-2.0
"""
waferbot for scripts and notebooks: models, logs, simulation, diagnosis, identification, tuning.

    import waferbot as wb

    model = wb.load_model('rigid')
    logs = wb.load_logs(['day1', 'day2'])
    result = wb.diagnose(model, logs, validation=wb.load_logs('day3'))
    result.causes                               # a table (pandas)
    result.extended_model.save('extended.yaml')
    run = wb.simulate(result.extended_model, experiment='step')
    run.to_dataframe()

Everything works without ROS. What is wrong with a model, a log or an argument is raised as `UserError`
with a message that says what to do. Units are SI, unless a column `unit` or a name says otherwise; axes
are `y_linear`, `x_rotate` and `y_rotate`.
"""

import waferbot_twin  # noqa: F401  first of all: linear algebra on one thread
from waferbot.diagnosis import Diagnosis, diagnose
from waferbot.identification import Identification, identify
from waferbot.logs import Imported, Log, import_log, load_logs
from waferbot.model import Model, load_model
from waferbot.simulation import Run, simulate
from waferbot.synthesis import Synthesis, synthesize
from waferbot.tuning import Tuned, tune
from waferbot_lockstep.errors import UserError
from waferbot_twin.diagnosis.inference.settings import Settings

__all__ = [
    'Diagnosis',
    'Identification',
    'Imported',
    'Log',
    'Model',
    'Run',
    'Settings',
    'Synthesis',
    'Tuned',
    'UserError',
    'diagnose',
    'identify',
    'import_log',
    'load_logs',
    'load_model',
    'simulate',
    'synthesize',
    'tune',
]
