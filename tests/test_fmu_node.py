# SPDX-License-Identifier: Apache-2.0
"""An FMU as the plant's node over ROS: the run is that of the native plant; what fails is told."""

from __future__ import annotations

import sys

import numpy as np
import pytest

from waferbot_twin.recording.reader import read_recording

TOPICS = ('encoders', 'phase_currents', 'current_command', 'phase_voltages', 'servo_state')
WHAT = ('--model', 'as_built', '--experiment', 'step', '--duration', '0.05')

pytestmark = [
    pytest.mark.long(70),
    pytest.mark.skipif(sys.platform != 'linux', reason='FMUs are tried on Linux alone'),
]


@pytest.fixture(scope='module', params=['3', '2'])
def fmu(request, tmp_path_factory):
    from waferbot_twin.effects.variant import Variant
    from waferbot_twin.fmi.export import export
    from waferbot_twin.models import load_model

    pytest.importorskip('fmpy')
    file = tmp_path_factory.mktemp('fmu') / f'plant{request.param}.fmu'
    export(Variant.of(load_model('as_built')), 'plant', (), request.param, file)
    return file


@pytest.mark.slow
@pytest.mark.parametrize('engine', ['ros', 'composed'])
def test_an_fmu_as_the_plants_node_gives_the_native_run(fmu, engine, start, tmp_path):
    ours, native = tmp_path / 'fmu', tmp_path / 'native'
    with_fmu = ('--plant', str(fmu), '--engine', engine)
    for out, how in ((ours, with_fmu), (native, ('--engine', 'inprocess'))):
        twin = start('waferbot_twin', 'run', *WHAT, *how, '--out', str(out))
        assert twin.wait() == 0, twin.output
        assert '0 missing of' in twin.output
    mine, theirs = read_recording(ours), read_recording(native)
    for topic in TOPICS:
        assert len(mine[topic]) == len(theirs[topic]) > 0
        for field in set(mine[topic].dtype.names) - {'encapsulation'}:
            np.testing.assert_allclose(
                mine[topic][field], theirs[topic][field], rtol=1e-9, atol=1e-9, err_msg=topic
            )
    assert mine.run['plant']['fmu'] == fmu.name
    replay = start('waferbot_twin', 'replay', str(ours), '--node', 'plant')
    assert replay.wait() == 1
    assert 'its plant was the FMU' in replay.output


@pytest.fixture
def refused(fmu, start, tmp_path):
    """Give a function that runs the FMU with a map of its names, and returns why that failed."""

    def run(text):
        names = tmp_path / 'names.yaml'
        names.write_text(text, 'utf-8')
        what = ('run', '--plant', fmu, '--plant-map', names, '--duration', '0.01')
        twin = start('waferbot_twin', *map(str, what))
        assert twin.wait() == 1
        assert 'Traceback' not in twin.output
        return twin.output

    return run


@pytest.mark.slow
def test_a_map_that_does_not_fit_is_told_before_a_node_starts(refused):
    for text, said in (
        ('y_linear_count: 0', "a plant has no 'y_linear_count'"),
        ('y_linear_counts: null', 'must be a name of the FMU, or a number, held'),
        ('y_linear_voltage_1: 3', 'must be a name of the FMU, or null'),
    ):
        output = refused(text)
        assert said in output
        assert 'ROS_DOMAIN_ID' not in output


@pytest.mark.slow
def test_an_fmu_that_lacks_something_ends_the_twin_with_its_reason(refused):
    assert "it has no output 'gone'" in refused('y_linear_counts: gone')
