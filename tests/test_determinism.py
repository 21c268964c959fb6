# SPDX-License-Identifier: Apache-2.0
"""What a run is made from must not depend on the hash seed of the Python process."""

import os
import subprocess
import sys

import pytest

DIGEST = """
import hashlib
from waferbot_copley.settings import amplifier_parameters
from waferbot_lockstep.timing import Timing
from waferbot_plant.plant import load_machine
from waferbot_pmac.experiments import commanded_positions, load_experiment, shipped_experiments
from waferbot_pmac.i_variables import servo_parameters
from waferbot_twin.models import load_model, model_names

digest = hashlib.sha256()
for name in model_names():
    model = load_model(name)
    servo = servo_parameters(model.of_axes('pmac'))
    digest.update(servo.tobytes())
    digest.update(amplifier_parameters(model.of_axes('copley')).tobytes())
    damping = model.parameters['plant'].get('damping', 'improved')
    machine = load_machine(model.description, damping=damping)
    parameters = machine.parameters()
    digest.update(parameters.tobytes())
    digest.update(machine.initial_state(parameters, holding=True).tobytes())
for name in shipped_experiments():
    positions = commanded_positions(load_experiment(name), servo, Timing().servo_hz)
    digest.update(positions.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.slow
def test_parameters_do_not_depend_on_the_hash_seed():
    digests = {}
    for seed in range(8):
        run = subprocess.run(
            [sys.executable, '-c', DIGEST],
            env={**os.environ, 'PYTHONHASHSEED': str(seed)},
            capture_output=True,
            text=True,
            timeout=120,
            check=True,
        )
        digests[seed] = run.stdout.strip()
    assert len(set(digests.values())) == 1, digests
