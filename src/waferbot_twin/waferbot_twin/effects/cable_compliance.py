# SPDX-License-Identifier: Apache-2.0
"""The cables between a lifting axis and its counterweight stretch, (5.1) to (5.3)."""

from __future__ import annotations

from waferbot_twin.effects.compliances import compliance_effect, stage

EFFECT = compliance_effect(
    'cable_compliance',
    'cables to the counterweight stretch',
    stage('cable'),
    title='compliance of the cables',
)
