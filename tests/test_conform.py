# SPDX-License-Identifier: Apache-2.0
"""The conformance kit: our own nodes pass, and each fault is found by the check that is made for it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from harness import waferbot

pytestmark = [pytest.mark.slow, pytest.mark.long(70)]

FAULTY = [sys.executable, str(Path(__file__).parent / 'faulty_pmac.py')]

FAULTS = {
    'speaks first': ('begins', 'spoke of tick 0 before it had any input'),
    'starts late and speaks first': ('begins', 'spoke of tick 0 before it had any input'),
    'stamps by accumulating': ('runs', 'tick 24 has the stamp 1333332 ns; it must be 1333333 ns'),
    'speaks for a fourth axis': ('runs', 'tick 0 speaks for axes that do not exist: 0xf'),
    'divides by zero': ('runs', 'tick 0 holds a value that is no finite number'),
    'lags by a cycle': ('runs', 'no answer for tick 8 within'),
    'answers every message': ('runs', 'tick 2 is none of this topic, which has every 8th'),
    'repeats nothing': ('signs of life', 'repeated its last message 0 times'),
    'believes everything': ('contradicting message', 'tick 160 came twice, and not the same'),
    'does not hear a stop': ('stop', 'still runs 5 s after a peer stopped'),
}


def conform(*arguments):
    result = waferbot('conform', '--json', *arguments)
    assert result.stdout, result.stderr
    return result.returncode, {one['check']: one for one in json.loads(result.stdout)}


OF_SEVERAL_INPUTS = ['runs', 'waits for all inputs', 'value not finite', 'silence']
"""The checks in which an amplifier, with its three inputs, has more to do than a controller."""


@pytest.mark.parametrize(('node', 'checks'), [('pmac', []), ('copley', OF_SEVERAL_INPUTS)])
def test_our_own_nodes_do_everything_right(node, checks):
    code, findings = conform(
        '--node', node, *(word for one in checks for word in ('--check', one))
    )
    assert {one['grade'] for one in findings.values()} == {'right'}, findings
    assert len(findings) == (len(checks) or 12)
    assert code == 0


def test_an_amplifier_of_one_axis_is_asked_for_that_axis_only():
    code, findings = conform(
        '--node', 'copley', '--axes', 'x_rotate', '--check', 'runs',
        sys.executable, '-m', 'waferbot_copley.node', '--ros-args', '-p', 'axes:=[x_rotate]',
    )  # fmt: skip
    assert findings['runs']['grade'] == 'right', findings
    assert code == 0


@pytest.mark.parametrize('fault', FAULTS)
def test_a_fault_is_found_and_said(fault):
    check, text = FAULTS[fault]
    code, findings = conform('--node', 'pmac', '--check', check, *FAULTY, fault)
    assert findings[check]['grade'] == 'wrong', findings
    assert text in findings[check]['text']
    assert code == 1


def test_a_program_that_ends_or_is_not_there_is_said():
    code, findings = conform('--node', 'pmac', '--check', 'runs', 'false')
    assert findings['runs']['text'] == 'ended with exit code 1, with tick 0 to be answered'
    assert code == 1
    result = waferbot('conform', '--node', 'pmac', '/no/such/program')
    assert result.returncode == 1
    assert result.stderr.endswith(
        '/no/such/program cannot be started: No such file or directory\n'
    )
    assert 'Traceback' not in result.stderr
