# SPDX-License-Identifier: Apache-2.0
"""`waferbot frf` as a user meets it, on the as-built machine's run."""

from __future__ import annotations

import json

import pytest
from harness import called, run_engine

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def as_built(tmp_path_factory):
    out = tmp_path_factory.mktemp('frf') / 'as_built'
    run_engine('inprocess', out, 'multisine_x_rotate', model='as_built')
    return out


def test_the_rigid_model_lacks_the_75_hz_line_of_the_machine_as_built(as_built, tmp_path):
    """The bearing of X-Rotate gives under moments; coupled modes of 69 and 74 Hz at home."""
    out = tmp_path / 'report'
    done = called('frf', str(as_built), '--model', 'rigid', '--out', str(out), '--json')
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told == json.loads((out / 'frf.json').read_text('utf-8'))
    assert (out / 'frf.png').stat().st_size > 20000
    assert (told['schema'], told['from'], told['to']) == (
        1, 'x_rotate.force', 'x_rotate.acceleration',
    )  # fmt: skip
    assert told['measured']['method'] == 'indirect'
    assert told['measured']['looks'] == 'periods'
    resonances = [peak for peak in told['peaks'] if peak['kind'] == 'resonance']
    assert [peak['verdict'] for peak in resonances] == ['missing in model']
    assert 64.0 < resonances[0]['frequency_hz'] < 78.0
    assert 'lacks the resonance at' in told['sentence']
    again = called('frf', str(as_built), '--out', str(out))
    assert again.returncode == 1
    assert 'exists already; choose another folder or give --force' in again.stderr


def test_the_model_that_made_the_log_has_all_its_peaks(as_built):
    done = called('frf', str(as_built), '--model', 'as_built', '--json')
    assert done.returncode == 0, done.stderr
    peaks = json.loads(done.stdout)['peaks']
    assert {peak['verdict'] for peak in peaks} == {'matched'}
    assert all(abs(peak['shift_percent']) < 0.01 for peak in peaks)
    assert any(64.0 < peak['frequency_hz'] < 78.0 for peak in peaks)
