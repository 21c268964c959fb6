# SPDX-License-Identifier: Apache-2.0
"""The coupling or the rack between motor and axis gives: bellows, jaws, a long drive shaft, teeth."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, stage

EFFECT = compliance_effect(
    'coupling_compliance',
    'the coupling or the rack of the drive gives',
    stage('coupling', 'rack'),
    title='compliance of the coupling',
)
